"""What data show of knees and muscles beside the moments of joints: frontal moments of knees, and EMG."""

from __future__ import annotations

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import counted, did_you_mean
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.inverse_dynamics.files.c3d_file import read_c3d
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable, cited
from mbdkit_biomech.inverse_dynamics.files.table_files import MOST_CELLS, read_table
from mbdkit_biomech.inverse_dynamics.motion.measured import source_table, times_of, with_gaps_bridged
from mbdkit_biomech.inverse_dynamics.motion.smoothing import low_passed
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Compartments, EmgTarget, Targets
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Butterworth, Emg, Frontal, TimeColumn
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

ENVELOPE = Butterworth(name="butterworth", cutoff=6.0)  #: Filter of a rectified raw signal.

#: A signal is raw if this filter removes more than this share of its variance.
RAW = 0.5

#: Largest activation of a channel with a stated scale from which its unit is wrong, and largest possible activation.
AT_REST, MOST = 0.01, 1.5


def measured_targets(spec: InverseSpec, names: QuantityNames, time: np.ndarray) -> Targets:
    """Return the soft targets of recruitment at times (T,), by the spec as given.

    Raises
    ------
    SpecError
        If EMG is that of an unknown muscle, its column is missing or is not between 0 and 1, or if compartments are
        asked for, but no plate is under a knee.
    """
    asked = {name: one if isinstance(one, Emg) else Emg(column=one) for name, one in spec.emg.items()}
    with spec.recording_files():
        tables = {file: _emg_table(spec, file) for file in dict.fromkeys(one.file for one in asked.values())}
    emg = [
        _channel(name, own, column, names, tables[own.file], spec, time)
        for name, own in asked.items()
        for column in own.columns
    ]
    return Targets(_knees(spec, names, time), tuple(emg))


def _emg_table(spec: InverseSpec, file: str | None) -> tuple[MeasuredTable, np.ndarray]:
    """Return the table of a file with EMG, or that of the motion, and its times; the channels of a C3D file."""
    if (own := file or spec.motion.file) is not None and own.lower().endswith(".c3d"):
        if (table := read_c3d(spec.folder / own, MOST_CELLS, channels=True)) is None:
            raise SpecError(
                "its analog channels have too many samples: export those of the muscles to a table", key="emg"
            )
        return table, times_of(table, TimeColumn(), "emg")
    if file is not None:
        table = read_table(spec.folder / file, "emg")
        return table, times_of(table, TimeColumn(), "emg")
    if (motion := source_table(spec.motion, spec.folder, "motion")) is None:
        raise SpecError("needs `file`, a table with the column, because the motion is that of a run", key="emg")
    return motion, times_of(motion, spec.motion.time, "motion.time")


def _knees(spec: InverseSpec, names: QuantityNames, time: np.ndarray) -> tuple[Compartments, ...]:
    if spec.person is None or spec.frontal == "none":
        return ()
    asked, person, joints = spec.frontal or Frontal(), spec.person, [*names.mechanism.joints]
    if spec.frontal and not person.plates.loads:
        raise SpecError(
            "needs force plates in three dimensions: columns such as plate1.force.x in the table of the motion, and "
            "`plates` in `loads`",
            key="frontal",
        )
    found = []
    for knee, own in person.knees.items():
        shank = names.body(names.mechanism.joints[knee].bodies[1], "model")
        deviation = own.deviation if asked.deviation is None else asked.deviation
        of_ground = (np.interp(time, person.time, x) for x in own[:2])
        found.append(Compartments(knee, joints.index(knee), shank, asked.width, deviation, *of_ground))
    return tuple(found)


def _channel(
    name: str,
    asked: Emg,
    column: str,
    names: QuantityNames,
    source: tuple[MeasuredTable, np.ndarray],
    spec: InverseSpec,
    time: np.ndarray,
) -> EmgTarget:
    muscles, key, (table, at) = list(names.mechanism.muscles), f"emg.{quoted(name)}", source
    if name not in muscles:
        raise SpecError(f"is no muscle of the model{did_you_mean(name, muscles)}", key=key)
    values = table.column(column, f"{key}.column")
    if not at[0] <= time[0] <= time[-1] <= at[-1]:
        raise SpecError(
            f"lasts from {at[0]:.6g} to {at[-1]:.6g} s, but the motion from {time[0]:.6g} to {time[-1]:.6g} s",
            key=f"{key}.file",
        )
    rows = np.flatnonzero((at >= time[0] - asked.delay) & (at <= time[-1]))
    if len(rows) < 2:
        raise SpecError(
            f"has {counted(len(rows), 'row')} during the motion, which lasts to {time[-1]:.6g} s", key=f"{key}.file"
        )
    at, values = at[rows], with_gaps_bridged(at[rows], values[rows], spec.motion.gaps, (table, column, rows))
    centred, is_fast = values - np.mean(values), np.median(np.diff(at)) < 0.25 / ENVELOPE.cutoff
    if is_fast and np.var(centred - low_passed(at, centred[:, None], ENVELOPE)[:, 0]) > RAW * np.var(values):
        values = low_passed(at, np.abs(centred)[:, None], ENVELOPE)[:, 0]
    has_scale = asked.scale != "estimated"
    values = np.interp(time - asked.delay, at, np.maximum(values, 0.0)) * (asked.scale if has_scale else 1.0)
    if not (largest := float(np.max(values))) > 0:
        raise SpecError(f"column '{cited(column)}' has no signal during the motion", key=f"{key}.column")
    if has_scale and not AT_REST <= largest <= MOST:
        raise SpecError(
            f"gives activations of up to {largest:.3g} (from {AT_REST:g} to {MOST:g} are possible): it should be 1 "
            "divided by the envelope in a maximal contraction, in the unit of the column; leave it out if this is not "
            "known",
            key=f"{key}.scale",
        )
    deviation = asked.deviation * len(asked.columns) ** 0.5  # channels of a muscle count as one together
    activation = np.minimum(values, 1.0) if has_scale else values
    return EmgTarget(muscles.index(name), activation, deviation, column, has_scale)
