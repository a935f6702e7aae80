"""Sentences on the estimated errors of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.headlines import excluded_error, largest_forces, plus_minus
from mbdkit.archive.peak_errors import peak_errors
from mbdkit.base.text import listed

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def accuracy_sentence(run: Run, *, with_force: bool = True) -> str:
    """Return a sentence on the estimated errors of a run: of the largest reaction force, and of the positions.

    In inverse dynamics, it states the largest reaction force with its error bar.

    Parameters
    ----------
    run
        The run. The sentence is empty if the run has no rows, or if its errors were not estimated; in inverse dynamics,
        it is also empty without joints.
    with_force
        Whether to state the largest force of a simulated run whose errors are all known.
    """
    accuracy = run.accuracy
    if run.kind == "inverse":
        return _error_bars(run)
    if accuracy is None or not len(run.time):
        return ""
    if not accuracy.rows_known:
        return f"errors unknown: {accuracy.unknown}"
    position = f"positions known to {accuracy.position_error_max:.2g} m and {accuracy.angle_error_max:.2g} rad"
    position += " for this mesh of beams" if excluded_error(run) else ""
    if accuracy.is_complete:
        return "; ".join(filter(None, (_largest_force(run) if with_force else "", position)))
    until = f" until {accuracy.known_until:.4g} s"
    force = _largest_known_force(run, accuracy.rows_known) if accuracy.rows_known > 1 else ""
    why = f": {accuracy.unknown}" if accuracy.unknown else ""
    return "; ".join(filter(None, (force and force + until, position + until, f"errors unknown afterwards{why}")))


def _largest_force(run: Run) -> str:
    """Return the largest force of all joints with its error, as headlines state it; empty if unknown."""
    largest = next(iter(largest_forces(run)), None)
    return "" if largest is None or math.isnan(largest.error) else f"{largest.label} {largest.text()}"


def _largest_known_force(run: Run, count: int) -> str:
    """Return the largest force of joints in the first `count` rows with its error; empty if there is none."""
    if not run.joints or not run.records("joints/reaction_force"):
        return ""
    size = np.linalg.norm(run.array("joints/reaction_force"), axis=2)[:count]
    errors = peak_errors(run, "reaction_error", size, count)
    joint = int(np.argmax(np.max(size, axis=0)))
    largest = float(np.max(size[:, joint]))
    if errors is None or math.isnan(errors[joint]) or largest <= 0:
        return ""
    return f"largest force in {run.joint_names[joint]} {plus_minus(largest, float(errors[joint]))} N"


def _why_no_error_bars(spec: Mapping[str, Any]) -> str:
    """Return the reason why a run of inverse dynamics has no error bars; empty if none were requested."""
    motion = spec.get("motion", {})
    if motion.get("errors") == "none":
        return ""
    of_run = str(motion.get("file", "")).lower().endswith(".h5") and motion.get("smooth", {}).get("name") == "none"
    if of_run or any(one.get("rate") is not None for one in (motion.get("columns") or {}).values()):
        where = "the archive" if of_run else "columns"
        return (
            f"velocities and accelerations are those of {where}, whose errors are not known; without them, mbdkit "
            "differentiates the positions and estimates errors"
        )
    if (spec.get("recruitment") or {}).get("dynamics") == "activation":
        return "they are not estimated with `dynamics: activation`, which couples the frames"
    return (
        "the noise cannot be estimated from residuals of a smoothed motion; state the `deviation` of each column, or "
        "smooth the motion"
    )


def _error_bars(run: Run) -> str:
    """Return a sentence on the error bar of the largest reaction force of inverse dynamics, or on why it is unknown.

    The sentence is empty if no error bars were requested, or if there are no joints.
    """
    accuracy = run.accuracy
    if accuracy is None:
        why = _why_no_error_bars(run.spec)
        return f"errors unknown: {why}" if why else ""
    size = np.linalg.norm(run.array("joints/reaction_force"), axis=2)
    if not size.size:
        return ""
    row, joint = (int(place) for place in np.unravel_index(np.argmax(size), size.shape))
    errors = peak_errors(run, "reaction_error", size, len(run.time))
    assert errors is not None
    error = float(errors[joint])
    told = f"; {exact}" if (exact := exact_loads(run)) else ""
    if not math.isfinite(error):
        known = f"{size[row, joint]:.4g} N at {run.time[row]:.4g} s, error unknown"
        return f"largest force in {run.joint_names[joint]} {known}{told}"
    value = plus_minus(float(size[row, joint]), error)
    return f"largest force in {run.joint_names[joint]} {value} N (95 %) at {run.time[row]:.4g} s{told}"


def exact_loads(run: Run) -> str:
    """Return a clause on the measured loads that error bars of inverse dynamics count as exact; empty if there are none
    or no error bars.
    """
    uncertain = run.spec.get("uncertainty") or {}
    names = (
        []
        if run.accuracy is None or {"pressure", "plate_gain"} & set(uncertain)
        else [name for name, load in (run.spec.get("loads") or {}).items() if any(map(_is_exact, _measured(load)))]
    )
    return f"loads count as exact where columns have no `deviation`: {listed(names, 'and')}" if names else ""


def _measured(load: Mapping[str, Any]) -> list[Any]:
    """Return the columns of data that a measured load refers to, without components that are constant numbers."""
    every = [*(load.get("force") or ()), *(load.get("point") or ()), load.get("torque")]
    return [one for one in every if one is not None and not isinstance(one, int | float)]


def _is_exact(column: Any) -> bool:
    return not (isinstance(column, Mapping) and column.get("deviation"))


def asked_sentence(run: Run) -> str:
    """Return sentences on the requested accuracy, the accuracy reached, and the choice of method; empty if none was
    requested.

    Parameters
    ----------
    run
        The run.
    """
    accuracy = run.accuracy
    if accuracy is None or math.isnan(accuracy.asked):
        return ""
    reached = "unknown" if math.isnan(accuracy.reached) else f"{accuracy.reached:.2g}"
    until = "" if accuracy.is_complete or math.isnan(accuracy.reached) else f" until {accuracy.known_until:.4g} s"
    text = f"{accuracy.asked:g} of the mechanism's size, reached by estimate {reached}{until}"
    return f"{text}; chosen: {accuracy.chosen}. {accuracy.why}"
