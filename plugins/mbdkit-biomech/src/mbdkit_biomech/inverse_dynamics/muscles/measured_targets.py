"""What data show of knees and muscles beside the moments of joints: frontal moments of knees, and EMG."""

from __future__ import annotations

import re

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.base.text import did_you_mean
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit_biomech.cited_text import cited
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.files.table_files import read_table
from mbdkit_biomech.inverse_dynamics.motion.measured import source_table, times_of, with_gaps_bridged
from mbdkit_biomech.inverse_dynamics.motion.smoothing import low_passed
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Compartments, EmgTarget, Targets
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Butterworth, Emg, Frontal, TimeColumn
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

ENVELOPE = Butterworth(name="butterworth", cutoff=6.0)  #: Filter of a rectified raw signal.

#: A signal is raw if its most negative value exceeds this share of its largest one; filters make envelopes slightly
#: negative.
RAW = 0.1

VOLTS = re.compile(r"[\[(]\s*[mun\u00b5\u03bc]?V\s*[\])]")  #: A voltage as the unit of a column.

#: Largest activation of a channel without `maximum` from which its unit is wrong, and largest possible activation.
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
    emg = [_channel(name, own, names, tables[own.file], spec, time) for name, own in asked.items()]
    return Targets(_knees(spec, names, time), tuple(emg))


def _emg_table(spec: InverseSpec, file: str | None) -> tuple[MeasuredTable, np.ndarray]:
    """Return the table of a file with EMG, or that of the motion, and its times."""
    if file is not None:
        table = read_table(spec.folder / file, "emg")
        return table, times_of(table, TimeColumn(), "emg")
    motion = source_table(spec.motion, spec.folder, "motion")
    if motion is None:
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
    return tuple(
        Compartments(
            knee,
            joints.index(knee),
            names.body(names.mechanism.joints[knee].bodies[1], "model"),
            asked.width,
            own.deviation if asked.deviation is None else asked.deviation,
            *(np.interp(time, person.time, x) for x in own[:2]),
        )
        for knee, own in person.knees.items()
    )


def _channel(
    name: str,
    asked: Emg,
    names: QuantityNames,
    source: tuple[MeasuredTable, np.ndarray],
    spec: InverseSpec,
    time: np.ndarray,
) -> EmgTarget:
    muscles, key, (table, at) = list(names.mechanism.muscles), f"emg.{quoted(name)}", source
    if name not in muscles:
        raise SpecError(f"is no muscle of the model{did_you_mean(name, muscles)}", key=key)
    values = table.column(asked.column, f"{key}.column")
    if not at[0] <= time[0] <= time[-1] <= at[-1]:
        raise SpecError(
            f"lasts from {at[0]:.6g} to {at[-1]:.6g} s, but the motion from {time[0]:.6g} to {time[-1]:.6g} s",
            key=f"{key}.file",
        )
    rows = np.flatnonzero((at >= time[0] - asked.delay) & (at <= time[-1]))
    at, values = at[rows], with_gaps_bridged(at[rows], values[rows], spec.motion.gaps, (table, asked.column, rows))
    is_raw = -np.min(values) > RAW * np.max(values)
    volts = VOLTS.search(f"{asked.column} ({table.unit(asked.column)})")
    if asked.maximum is None and (is_raw or volts):
        what = "is a raw signal, which has negative values" if is_raw else "is a voltage"
        raise SpecError(
            f"is missing: column '{cited(asked.column)}' {what}, and is no activation between 0 and 1; give the "
            "envelope in a maximal contraction, in the unit of the column",
            key=f"{key}.maximum",
        )
    if is_raw:
        values = low_passed(at, np.abs(values - np.mean(values))[:, None], ENVELOPE)[:, 0]
    values = np.interp(time - asked.delay, at, np.maximum(values, 0.0)) / (asked.maximum or 1.0)
    largest = float(np.max(values))
    if largest > MOST or (asked.maximum is None and largest < AT_REST):
        stated = "its" if asked.maximum else "1, which is its default"
        raise SpecError(
            f"is up to {largest:.3g} times {stated} `maximum`, the envelope in a maximal contraction: give "
            "`maximum` in the unit of the column",
            key=f"{key}.maximum",
        )
    return EmgTarget(muscles.index(name), np.minimum(values, 1.0), asked.deviation, asked.column)
