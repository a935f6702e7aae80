"""Loads of inverse dynamics in reports and notebooks: pictures, numbers, disagreement of model and data."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mbdkit.archive.headlines import EXACT
from mbdkit.archive.run import Run
from mbdkit.base.text import listed
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_biomech.inverse_dynamics.loads.load_frames import load_drawing
from mbdkit_biomech.inverse_dynamics.results.inverse_summary import reserve_shares
from mbdkit_biomech.inverse_dynamics.results.workload import ElementWorkload, Workload, workload
from mbdkit_biomech.uncertainty.contributions import uncertainty_charts, uncertainty_sections
from mbdkit_report import Axis, Cell, Figure, Line, Section, Table, View, bands, bar_cells, bar_columns, columns_of
from mbdkit_report.notebook.result_views import object_view
from mbdkit_report.seams import report_charts, report_sections

_POINTS = 1_000
_TIME = Axis("time", "s")


@report_sections
def inverse_sections(run: Run, mechanism: Mechanism | None) -> tuple[Section, ...]:
    """Return the sections of a run of inverse dynamics that has at least two rows; empty for other runs."""
    if run.kind != "inverse" or len(run.time) < 2:
        return ()
    return (
        Section("loads", "Loads over the motion", (), load_drawing(run, mechanism)),
        Section("workload", "Workload", (), None, (_workload_table(workload(run).elements),)),
        *_muscles(run),
        _disagreement(run),
        *uncertainty_sections(run),
    )


@report_charts
def inverse_charts(run: Run) -> list[Figure]:
    """Return the charts of a run of inverse dynamics; empty for other runs.

    They show the residuals of the data (one chart for each unit), the joint forces with and without muscles, and the
    misalignment of the joints in the data. Charts without data are left out.
    """
    if run.kind != "inverse":
        return []
    observed = list(run.motion.values())
    found = []
    for unit, word in (("rad", "angles"), ("m", "lengths")):
        chosen = [index for index, one in enumerate(observed) if one.units == unit]
        if any(np.nanmax(np.abs(observed[index].residual), initial=0.0) > EXACT for index in chosen):
            lines = _lines(run, run.array("motion/residual")[:, chosen], [observed[k].name for k in chosen])
            caption = f"Measured minus fitted value of each of the observed {word}."
            axis = Axis("residual", unit)
            found.append(Figure(f"residual-{word}", f"Residuals of {word}", caption, _TIME, axis, tuple(lines)))
    found += _contact_chart(run)
    raw = run.array("motion/raw_misalignment")
    if known := [index for index in range(raw.shape[1]) if np.any(np.isfinite(raw[:, index]))]:
        lines = _lines(run, raw[:, known], [run.joint_names[k] for k in known])
        caption = "Misalignment of the joints if the bodies were placed by the measured data alone."
        axis = Axis("misalignment", "m")
        found.append(Figure("raw-misalignment", "Misalignment of the data", caption, _TIME, axis, tuple(lines)))
    return found + uncertainty_charts(run)


def _lines(run: Run, values: np.ndarray, names: Iterable[str]) -> list[Line]:
    """Return the lines of values (T, N) over time, by their names."""
    curves = bands(np.asarray(run.time), values, points=_POINTS)
    return [Line(name, *curves.curve(index)) for index, name in enumerate(names)]


def _muscles(run: Run) -> tuple[Section, ...]:
    """Return the section on joint forces with and without muscles, and on reserve actuators; empty if there are no
    muscles.
    """
    if not run.muscles:
        return ()
    without = np.linalg.norm(run.array("muscles/reaction_force_without"), axis=2)
    joints: list[tuple[Cell, ...]] = []
    for index, (name, joint) in enumerate(run.joints.items()):
        peak = float(np.max(np.linalg.norm(joint.reaction_force, axis=1)))
        alone = float(np.max(without[:, index]))
        joints.append((name, peak, alone, peak / alone if alone > 0 else None))
    muscles: list[tuple[Cell, ...]] = []
    for name, muscle in run.muscles.items():
        row = int(np.argmax(muscle.force))
        error = float(muscle.force_error[row])
        values = (float(np.max(muscle.activation)), float(np.mean(muscle.activation)), float(muscle.force[row]))
        muscles.append((name, *values, error if np.isfinite(error) else None, float(run.time[row])))
    told = [f"{share:.2%} of {name}" for name, share in reserve_shares(run).items()]
    sentence = "Muscles alone exert the moments of the joints that they act on: there are no reserves."
    if told:
        sentence = f"Reserves exert {listed(told, 'and')} (root mean squares); muscles exert the rest."
    of_joints = columns_of("joint; with muscles [N]; without muscles [N]; ratio")
    of_muscles = columns_of(
        "muscle; largest activation; mean activation; largest tension [N]; error of the largest [N]; "
        "time of the largest [s]"
    )
    note = "Without muscles, actuators would drive the joints."
    bounds = "Errors are bounds that hold with a probability of 95 %."
    tables = (
        Table("contact-forces", "Largest joint forces", of_joints, tuple(joints), note),
        Table("muscles", "Muscles", of_muscles, tuple(muscles), bounds),
    )
    return (Section("muscles", "Muscles", (sentence,), None, tables),)


def _contact_chart(run: Run) -> list[Figure]:
    if not run.muscles:
        return []
    lines: list[Line] = []
    for path, word in (("joints/reaction_force", ""), ("muscles/reaction_force_without", " without muscles")):
        lines += _lines(run, np.linalg.norm(run.array(path), axis=2), (f"{name}{word}" for name in run.joint_names))
    caption = "Force in each joint with the forces of the muscles, and if actuators drove the joints instead."
    title = "Joint forces with and without muscles"
    return [Figure("contact", title, caption, _TIME, Axis("force", "N"), tuple(lines))]


def _workload_table(elements: tuple[ElementWorkload, ...]) -> Table:
    loads = [load for one in elements for load in (one.load, one.torque) if load is not None]
    bars = bar_columns("the peak", "", [load.peak_error for load in loads])
    columns = (
        *columns_of("joint or actuator; kind; unit; peak"),
        *bars,
        *columns_of("rms; impulse; loading rate; largest power [W]; least power [W]; work done [J]; work absorbed [J]"),
    )
    rows: list[tuple[Cell, ...]] = []
    for element in elements:
        work, nothing = element.work, (None,) * 4
        power = nothing if work is None else (work.peak_power, work.least_power, work.positive, -work.negative)
        for load, of_load in ((element.load, power), (element.torque, nothing)):
            if load is not None:
                peak = bar_cells(load.peak, load.peak_error, load.id, len(bars))
                numbers = (load.rms, load.impulse, load.loading_rate)
                rows.append((element.name, element.kind, load.units, *peak, *numbers, *of_load))
    note = (
        "Errors are bounds that hold with a probability of 95 %. Impulses are in N s or N m s, loading rates in N/s or "
        "N m/s. Residuals act from outside on a part that no joint connects to the ground."
    )
    return Table("workload", "Workload of joints and actuators", columns, tuple(rows), note)


def _disagreement(run: Run) -> Section:
    time = np.asarray(run.time)
    rows: list[tuple[Cell, ...]] = []
    worst: dict[str, tuple[float, str, float]] = {}
    for name, one in run.motion.items():
        size = np.abs(np.nan_to_num(one.residual))
        row = int(np.argmax(size))
        peak, when = float(size[row]), float(time[row])
        rms = float(np.sqrt(np.nanmean(one.residual**2))) if np.any(np.isfinite(one.residual)) else 0.0
        rows.append((name, one.units, rms, peak, when))
        worst[one.units] = max(worst.get(one.units, (0.0, "", 0.0)), (peak, name, when))
    heads = columns_of("observed quantity; unit; rms of the residual; largest residual; time of the largest [s]")
    note = "Measured minus fitted value; gaps are left out."
    residuals = Table("residuals", "Residuals of the columns", heads, tuple(rows), note)
    raw = run.array("motion/raw_misalignment")
    gaps: list[tuple[Cell, ...]] = []
    for index, joint in enumerate(run.joint_names):
        known = np.isfinite(raw[:, index])
        if np.any(known):
            values = raw[known, index]
            at = float(time[known][int(np.argmax(values))])
            gaps.append((joint, float(np.sqrt(np.mean(values**2))), float(values.max()), at))
    heads = columns_of("joint; rms [m]; largest [m]; time of the largest [s]")
    note = "Misalignment of a joint if the bodies were placed by the measured data alone."
    tables = [residuals] if any(peak > EXACT for peak, _, _ in worst.values()) else []
    if gaps:
        tables.append(Table("raw-gaps", "Misalignment of the data", heads, tuple(gaps), note))
    told = [
        f"{peak:.3g} {unit} ({name}, at {when:.4g} s)" for unit, (peak, name, when) in worst.items() if peak > EXACT
    ]
    sentence = f"The largest residuals are {' and '.join(told)}." if told else "The model fits the data exactly."
    if not gaps:
        sentence += " The data do not determine the positions of both bodies of any joint: misalignments are unknown."
    return Section("data", "Differences between model and data", (sentence,), None, tuple(tables))


@object_view
def workload_view(found: Workload) -> View:
    """Return the view of a workload."""
    sentences = f"From {found.start:g} s to {found.end:g} s.", found.note
    return View("Workload", sentences, tables=(_workload_table(found.elements),))
