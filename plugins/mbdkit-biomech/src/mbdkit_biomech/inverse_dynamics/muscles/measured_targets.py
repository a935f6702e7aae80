"""What data show of knees and muscles beside the moments of joints: frontal moments of knees, and EMG."""

from __future__ import annotations

import numpy as np

from mbdkit.plugin import QuantityNames, SpecError, did_you_mean, quoted
from mbdkit_biomech.inverse_dynamics.files.measured_table import MeasuredTable
from mbdkit_biomech.inverse_dynamics.motion.measured import source_table, times_of
from mbdkit_biomech.inverse_dynamics.motion.smoothing import low_passed
from mbdkit_biomech.inverse_dynamics.muscles.soft_targets import Compartments, EmgTarget, Targets
from mbdkit_biomech.inverse_dynamics.spec.inverse_sections import Butterworth, Emg, Frontal
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

ENVELOPE = Butterworth(name="butterworth", cutoff=6.0)
"""Filter of a rectified raw signal."""


def measured_targets(spec: InverseSpec, names: QuantityNames, time: np.ndarray) -> Targets:
    """Return the soft targets of recruitment at times (T,), by the spec as given.

    Raises
    ------
    SpecError
        If EMG is that of an unknown muscle, or its column is missing or is not between 0 and 1.
    """
    emg = []
    if spec.emg:
        with spec.recording_files():
            table = source_table(spec.motion, spec.folder, "motion")
        for name, asked in spec.emg.items():
            own = asked if isinstance(asked, Emg) else Emg(column=asked)
            if table is None:
                raise SpecError("needs a table with the column, but the motion is that of a run", key="emg")
            emg.append(_channel(name, own, names, table, times_of(table, spec.motion.time, "motion.time"), time))
    return Targets(_knees(spec, names, time), tuple(emg))


def _knees(spec: InverseSpec, names: QuantityNames, time: np.ndarray) -> tuple[Compartments, ...]:
    if spec.person is None or spec.frontal == "none":
        return ()
    asked, person, joints = spec.frontal or Frontal(), spec.person, [*names.mechanism.joints]
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
    name: str, asked: Emg, names: QuantityNames, table: MeasuredTable, at: np.ndarray, time: np.ndarray
) -> EmgTarget:
    muscles, key = list(names.mechanism.muscles), f"emg.{quoted(name)}"
    if name not in muscles:
        raise SpecError(f"is no muscle of the model{did_you_mean(name, muscles)}", key=key)
    values = table.column(asked.column, f"{key}.column")
    known = np.isfinite(values)
    if not known.any():
        raise SpecError("has no values", key=f"{key}.column")
    if np.any(values[known] < 0.0):
        whole = np.interp(at, at[known], np.abs(values[known] - np.mean(values[known])))
        values, known = np.maximum(low_passed(at, whole[:, None], ENVELOPE)[:, 0], 0.0), np.ones(len(at), dtype=bool)
    values = np.interp(time - asked.delay, at[known], values[known]) / (asked.maximum or 1.0)
    if np.max(values) > 1.5:
        raise SpecError(
            f"is up to {np.max(values):.3g} times its `maximum`, the envelope in a maximal contraction: give it in the "
            "unit of the column",
            key=f"{key}.maximum",
        )
    return EmgTarget(muscles.index(name), np.clip(values, 0.0, 1.0), asked.deviation)
