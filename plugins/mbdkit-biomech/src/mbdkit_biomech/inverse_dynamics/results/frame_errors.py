"""Error bars of inverse dynamics: those of largest values, and sentences on them.

Unlike the errors of simulated runs, those of different frames are independent: each is a bound that holds at its time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbdkit.archive.accuracy_summary import RunErrors
from mbdkit.archive.headlines import JOINTS_NAMED, answers
from mbdkit.archive.result_seams import run_attribute
from mbdkit.archive.run import Run
from mbdkit.base.text import listed


class FrameErrors(RunErrors):
    """What is known of the errors of a run of inverse dynamics."""

    never_good = (
        "Inverse dynamics is never `good`, because error bars do not include errors of the model: to know more, "
        "compare it with a measured force, or with another model of the person."
    )

    def __init__(self, run: Run):
        super().__init__(run)
        if not run.spec.get("recruitment"):  # a resultant, which is no contact force
            self.force_in = "joint force without muscles in"

    @property
    def are_estimated(self) -> bool:
        """Whether there are error bars."""
        return self.run.verdict == "good" or self.run.accuracy is not None

    @property
    def unknown_times(self) -> str:
        """Phrase with the times at which error bars are unknown; empty if all are known."""
        run = self.run
        borders = np.flatnonzero(np.diff(np.concatenate([[True], known_rows(run), [True]])))
        spans = [
            f"from t = {run.time[i]:.6g} to {run.time[end - 1]:.6g} s" for i, end in borders.reshape(-1, 2).tolist()
        ]
        more = f" and in {len(spans) - JOINTS_NAMED} more intervals" if len(spans) > JOINTS_NAMED else ""
        return ", ".join(spans[:JOINTS_NAMED]) + more

    def errors_of_largest(
        self, quantity: str, names: Sequence[str], size: np.ndarray, errors: np.ndarray, missed: np.ndarray | None
    ) -> np.ndarray:
        """Return the errors (E,) of the largest values of joints or actuators; see `RunErrors.errors_of_largest`.

        If the run has a measure such as ``max(abs(joints.NAME.force))`` for the value, the error is that of the
        measure, so that a number has the same bar wherever it is printed. Otherwise it is that of the frame with the
        largest value. These two can differ: that of the measure is sampled for the maximum itself, while that of a
        frame is a bound for a vector, or belongs to a single frame.
        """
        run, rows = self.run, np.argmax(np.nan_to_num(size), axis=0)
        bars = np.take_along_axis(errors, rows[None], axis=0)[0].copy()
        parts = {} if run.accuracy is None or quantity != "joints.force" else run.accuracy.parts
        if "reaction_peak_error" in parts:  # contains that another frame may have the largest force
            of_data = np.take_along_axis(parts["reaction_error_data"], rows[None], axis=0)[0]
            bars = np.where(np.isfinite(bars), np.sqrt(of_data**2 + parts["reaction_peak_error"] ** 2), np.nan)
        for index, value, error in self.of_measures(quantity, names):
            if np.isclose(value, size[rows[index], index], rtol=1e-9, atol=0.0):
                bars[index] = error
        return np.asarray(bars)

    def sentence(self, *, with_force: bool = True) -> str:
        """Return a sentence on the error bar of the largest reaction force, or on why it is unknown; without the force,
        on error bars in general. It is empty if no error bars were requested, or if there are no joints.
        """
        run, accuracy = self.run, self.run.accuracy
        if accuracy is None:
            why = _why_no_error_bars(run.spec)
            return f"errors unknown: {why}" if why else ""
        largest = next((one for one in answers(run) if one.quantity == "joints.force"), None)
        if largest is None:
            return ""
        loads = f"; {exact}" if (exact := exact_loads(run)) else ""
        if not with_force:
            unknown = f", unknown {times}" if (times := self.unknown_times) else ""
            return f"error bars hold with a probability of 95 %{unknown}{loads}"
        at = f"at {largest.time:.4f} s"
        if not largest.bar.is_known:
            return f"{largest.label} {largest.value:.4g} N {at}, error unknown{loads}"
        joint = run.joint_names.index(largest.element)
        bias = float(accuracy.parts["reaction_peak_bias"][joint]) if "reaction_peak_bias" in accuracy.parts else 0.0
        least = f"; less its expected excess, {largest.value - bias:.4g} N" if bias else ""
        return f"{largest.label} {largest.text()} (95 %) {at}{least}{loads}"


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


def exact_loads(run: Run) -> str:
    """Return a clause on the measured loads that error bars of inverse dynamics count as exact; empty if there are none
    or no error bars.
    """
    uncertain = run.spec.get("uncertainty") or {}
    if run.accuracy is None or {"pressure", "plate_gain"} & set(uncertain):
        return ""
    names = [name for name, load in (run.spec.get("loads") or {}).items() if _is_exact(load)]
    return f"loads count as exact where columns have no `deviation`: {listed(names, 'and')}" if names else ""


def _is_exact(load: Mapping[str, Any]) -> bool:
    """Return whether a measured load has a column without `deviation`; constant numbers are no columns."""
    every = [*(load.get("force") or ()), *(load.get("point") or ()), load.get("torque")]
    return any(isinstance(one, str) or (isinstance(one, Mapping) and not one.get("deviation")) for one in every)


def known_rows(run: Run) -> np.ndarray:
    """Return the rows (T,) in which all errors are known, or not estimated."""
    errors = [] if run.accuracy is None else [run.accuracy.reaction_error]
    errors += [run.array("actuators/value_error")] if errors and run.records("actuators/value_error") else []
    known = np.ones(len(run.time), dtype=bool)
    return np.asarray(np.all([known, *(~np.any(np.isnan(error), axis=1) for error in errors)], axis=0))


@run_attribute
def raw_misalignment(run: Run) -> np.ndarray:
    """Return the misalignment of each joint if bodies are placed by the measured data alone, (T, J) [m]; nan where
    undetermined. Raises MbdkitError if the run is not of inverse dynamics.
    """
    return run.array("motion/raw_misalignment")
