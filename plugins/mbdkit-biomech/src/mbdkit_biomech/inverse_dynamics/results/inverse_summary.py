"""Lines of the summary of a run that only inverse dynamics has."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit.archive.headlines import EXACT, JOINTS_NAMED, Headline, largest_of, run_headlines
from mbdkit.archive.result_seams import summary_lines
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import few
from mbdkit.base.text import counted, plus_minus
from mbdkit_biomech.inverse_dynamics.results.frame_errors import known_rows
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import RESERVE
from mbdkit_biomech.uncertainty.contributions import uncertainty_lines

#: Labels of entries of the provenance of inverse dynamics: markers without data, and columns that are not used.
UNUSED_DATA = {"unobserved_markers": "no data", "unused_columns": "not used"}

PERSON = ("subject", "centres", "plane", "plates")  #: Entries of the provenance of a person.


@summary_lines
def inverse_lines(run: Run) -> list[tuple[str, str]]:
    """Return the lines of the summary that only inverse dynamics has, each with its label; texts may be empty."""
    return [
        *((label, str(run.provenance.get(label, ""))) for label in PERSON),
        ("smoothing", _smoothing(run.spec)),
        ("fit", _fit(run)),
        *((label, str(run.provenance.get(key, ""))) for key, label in UNUSED_DATA.items()),
        ("gaps", _gaps(run)),
        ("raw data", _raw_misalignment(run)),
        ("actuators", _actuators(run)),
        ("residuals", _actuators(run, residual=True)),
        ("reserves", _reserves(run)),
        ("compression", _compressions(run)),
        *uncertainty_lines(run),
    ]


def _compressions(run: Run) -> str:
    """Return the largest compression of each knee, with its bar, and that of its compartments then."""
    texts = []
    for name, knee in run.knees.items():
        row = int(np.argmax(np.nan_to_num(knee.compression)))
        bar = (float(knee.compression_lower[row]), float(knee.compression_upper[row]))
        value = float(knee.compression[row])
        number = plus_minus(value, bar) if np.isfinite(sum(bar)) else f"{value:.4g}"
        parts = (f"{side} {getattr(knee, f'{side}_force')[row]:.4g}" for side in ("medial", "lateral"))
        more = f" ({', '.join(parts)})" if np.isfinite(knee.medial_force[row]) else ""
        texts.append(f"{name} {number} N at {run.time[row]:.4f} s{more}")
    return ", ".join(texts)


@run_headlines
def largest_actuators(run: Run) -> list[Headline]:
    """Return the largest values of actuators; the two largest without residual loads are headlines."""
    if run.kind != "inverse" or not run.records("actuators/value"):
        return []
    values, own = run.array("actuators/value"), run.actuators
    errors = run.array("actuators/value_error") if run.records("actuators/value_error") else None
    found = largest_of("peak of", run, "actuators.value", list(own), np.abs(values), "", errors)
    main = [one.element for one in found if own[one.element].kind != "residual"][:2]
    return [one._replace(unit=own[one.element].units, is_main=one.element in main) for one in found]


def _smoothing(spec: Mapping[str, Any]) -> str:
    """Return the smoothing of the measured motion and its options."""
    chosen = spec.get("motion", {}).get("smooth", {})
    options = [f"{key} {value}" for key, value in chosen.items() if key != "name" and value is not None]
    return ", ".join([*([str(chosen["name"])] if chosen else []), *options])


def _fit(run: Run) -> str:
    parts = []
    for name, one in run.motion.items():
        known = one.residual[np.isfinite(one.residual)]
        parts.append((float(np.sqrt(np.mean(known**2))) if known.size else math.nan, name, one.units))
    parts.sort(reverse=True)
    if parts and parts[0][0] <= EXACT:
        return "exact to round-off"
    texts = [f"{name} {size:.3g} {units}" for size, name, units in parts]
    return f"residuals (rms) {few(texts, ', ')}" if parts else ""


def _gaps(run: Run) -> str:
    """Return the gaps of the measured columns, how they are filled, and whether errors are unknown there; empty if
    there are none.
    """
    texts: dict[str, list[str]] = {"by interpolation": [], "from the other columns": []}
    placed = json.loads(str(run.provenance.get("placed_gaps", "{}")))
    known = known_rows(run)
    for name, one in run.motion.items():
        missing = np.concatenate([[False], np.isnan(one.raw), [False]])
        for first, end in np.flatnonzero(np.diff(missing)).reshape(-1, 2).tolist():
            span = f"from t = {run.time[first]:.6g} to {run.time[end - 1]:.6g} s"
            told = "" if np.all(known[first:end]) else ", where errors are unknown"
            how = "from the other columns" if first in placed.get(name, ()) else "by interpolation"
            texts[how].append(f"{name}, {counted(end - first, 'sample')} {span}{told}")
    return "; ".join(f"filled {how}: {few(own)}" for how, own in texts.items() if own)


def _raw_misalignment(run: Run) -> str:
    """Return the largest misalignments of joints if bodies are placed by the measured data alone.

    Empty if the data determine none.
    """
    if not run.records("motion/raw_misalignment"):
        return ""
    gaps = run.array("motion/raw_misalignment")
    largest = np.max(np.where(np.isfinite(gaps), gaps, -1.0), axis=0, initial=-1.0)
    order = [int(k) for k in np.argsort(-largest, kind="stable")[:JOINTS_NAMED] if largest[k] >= 0]
    text = ", ".join(f"{run.joint_names[k]} {largest[k]:.2g} m" for k in order)
    return f"misaligned by at most {text}" if text else ""


def _actuators(run: Run, *, residual: bool = False) -> str:
    """Return the largest value of each actuator with its error bar and time: the largest of these, in descending order.

    With `residual`, return those of the residual loads instead.
    """
    texts = []
    for one in largest_actuators(run):
        actuator = run.actuators[one.element]
        if (actuator.kind == "residual") == residual:
            sign = ", negative" * bool(actuator.value[int(np.argmax(np.abs(actuator.value)))] < 0)
            texts.append(f"{one.element} {one.text()} at {one.time:.4f} s{sign}")
    return few(texts)


def _reserves(run: Run) -> str:
    """Return the root mean square of each reserve as a share of that of the total moment.

    Empty without recruitment.
    """
    if not run.records("muscles/certificate"):
        return ""
    return ", ".join(f"{name} {share:.2%}" for name, share in reserve_shares(run).items()) or "none"


def reserve_shares(run: Run) -> dict[str, float]:
    """Return the root mean square of each reserve relative to that of the total moment of its actuator, by actuator.

    Reserves that are not used are left out.
    """
    shares = {}
    for name, reserve in run.actuators.items():
        actuator = name.removeprefix(RESERVE)
        if name == actuator or actuator not in run.actuators:
            continue
        own, whole = (float(np.sqrt(np.mean(one.value**2))) for one in (reserve, run.actuators[actuator]))
        if own > 0:  # otherwise no muscle acts on this actuator
            shares[actuator] = own / whole if whole > 0 else 0.0
    return shares
