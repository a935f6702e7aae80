"""The plot `beams`: bending moment, shear force and axial force along beams at some times, and their largest magnitude
over time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdkit.archive.run import Run
from mbdkit.archive.run_views import BeamForce, Names
from mbdkit.base.errors import SpecError
from mbdkit.base.text import listed
from mbdkit_report.figures.beam_curves import has_beams
from mbdkit_report.figures.curves import Array, bands
from mbdkit_report.figures.page_model import TIME, Axis, Figure, Line
from mbdkit_report.figures.palette import PALETTE
from mbdkit_report.figures.scene import nearest_rows
from mbdkit_report.plot.charts import named
from mbdkit_report.plot.element_quantity import MOST

_TITLES: dict[BeamForce, str] = {"moment": "Bending moment", "shear": "Shear force", "axial": "Axial force"}
_TIMES = 5
_ALONG = Axis("distance from the end a", "m")


class BeamPeak(NamedTuple):
    """Largest magnitude of an internal force of a beam: the value with its sign [N or N m], nan if no value is finite;
    its time [s]; its distance `place` from end a along the beam [m]; and its recorded row.
    """

    value: float
    time: float
    place: float
    row: int


def beam_peak(run: Run, beam: str, component: BeamForce) -> BeamPeak:
    """Return the largest magnitude of an internal force over the whole beam, including its ends, and all rows."""
    values = run.beams[beam].along(component)
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    row, element = (int(place) for place in np.unravel_index(int(np.argmax(size)), size.shape))
    value = float(values[row, element]) if size[row, element] >= 0 else float("nan")
    return BeamPeak(value, float(run.time[row]), float(run.beams[beam].arc_length[element]), row)


def charts(run: Run) -> list[Figure]:
    """Return the charts of each internal force: along the beam with the largest value, and over time; empty if the run
    did not record internal forces of beams.
    """
    drawn = (_along, _over_time) if has_beams(run) else ()
    return [draw(run, which) for draw in drawn for which in _TITLES]


def chart(
    run: Run,
    *,
    beams: Names = None,
    components: BeamForce = "moment",
    times: float | Sequence[float] | None = None,
    most: int = MOST,
) -> Figure:
    """Return the chart of an internal force of beams: along the beams at the given `times` or, by default, the largest
    magnitude in each beam over time; the options are those of `RunPlots.beams`.

    Raises
    ------
    SpecError, UnknownNameError, NotRecordedError
        If the component is unknown, a time lies outside the run, the run has no beams, or no such beam, or did not
        record the internal forces of beams.
    """
    if components not in _TITLES:
        raise SpecError(f"the components of a plot of beams should be {listed(_TITLES, 'or')}, not {components!r}")
    if not run.beams:
        raise SpecError("this run has no beams")
    names = _picked(run, beams, components, most)
    if times is None:
        return _over_time(run, components, names)
    return _along(run, components, names, np.atleast_1d(np.asarray(times, dtype=float)))


def _picked(run: Run, wanted: Names, component: BeamForce, most: int) -> list[str]:
    known = list(run.beams)
    if wanted is None:
        size = [abs(beam_peak(run, name, component).value) for name in known]
        return [known[k] for k in sorted(np.argsort(-np.nan_to_num(size), kind="stable")[:most].tolist())]
    return named(wanted, known, "beam")


def _axis(component: BeamForce) -> Axis:
    return Axis(_TITLES[component].lower(), "N m" if component == "moment" else "N")


def _along(run: Run, component: BeamForce, names: Sequence[str] | None = None, times: Array | None = None) -> Figure:
    """Return the chart of an internal force along beams; by default along the beam with the largest value, at up to
    five times.
    """
    names = _picked(run, None, component, 1) if names is None else names
    rows = _rows(run, names[0], component) if times is None else _rows_at(run, times)
    lines = []
    for name in names:
        values, arc_length = run.beams[name].along(component), run.beams[name].arc_length
        for k, row in enumerate(rows):
            time, color = f"{run.time[row]:.4g} s", PALETTE[k] if k < len(PALETTE) else ""
            label = f"{name}, {time}" if len(names) > 1 else time
            lines.append(Line(label, arc_length, values[row], group=time, color=color))
    where = f" along {names[0]}" if len(names) == 1 else " along beams"
    frame = "; positive moments turn the far part counter-clockwise."
    frame = frame if component == "moment" else ", in the frame of its cross-section."
    caption = f"In the middle of each element and at both ends{where}{frame}"
    return Figure(f"beams-{component}", f"{_TITLES[component]}{where}", caption, _ALONG, _axis(component), tuple(lines))


def _rows(run: Run, name: str, component: BeamForce) -> list[int]:
    """Return up to five rows spread over the run; in one of them the internal force of a beam is largest."""
    spread = nearest_rows(run.time, np.linspace(run.time[0], run.time[-1], _TIMES)).tolist()
    peak = beam_peak(run, name, component).row
    spread[min(range(len(spread)), key=lambda k: abs(spread[k] - peak))] = peak
    return list(dict.fromkeys(spread))


def _rows_at(run: Run, times: Array) -> list[int]:
    first, last = float(run.time[0]), float(run.time[-1])
    for time in times.tolist():
        if not first <= time <= last:
            raise SpecError(f"the time {time:g} s lies outside of the run, which recorded {first:g} to {last:g} s")
    return list(dict.fromkeys(nearest_rows(run.time, times).tolist()))


def _over_time(run: Run, component: BeamForce, names: Sequence[str] | None = None) -> Figure:
    """Return the chart of the largest magnitude in each of several beams over time."""
    chosen = _picked(run, None, component, MOST) if names is None else names
    time = np.asarray(run.time)
    largest = np.stack([np.max(np.abs(run.beams[name].along(component)), axis=1) for name in chosen], axis=1)
    result = bands(time, largest)
    axis, caption = _axis(component), "Largest magnitude along a beam, ends included."
    lines = tuple(Line(name, *result.curve(k), group=name) for k, name in enumerate(chosen))
    return Figure(f"beams-{component}-over-time", f"Largest {axis.label} over time", caption, TIME, axis, lines)
