"""The values that inputs of a mechanism have during a run: the times at which each is set."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.engine.compiled_mechanism import CompiledMechanism


def same_time(*times: float) -> float:
    """Return the largest difference of two times of a run that counts as rounding error [s].

    `times`: start and end of the run, or its largest time [s].
    """
    return 4.0 * float(np.spacing(max(map(abs, times))))


@dataclass(frozen=True)
class InputSchedule:
    """The values of one input.

    `times`: (K,) increasing times at which the input is set [s]. `values`: (K,) its values from then on, in its unit.
    `slopes`: (K,) its rates from then on; 0 for an input that is constant until it is set again.
    """

    times: tuple[float, ...] = ()
    values: tuple[float, ...] = ()
    slopes: tuple[float, ...] = ()

    @classmethod
    def of(cls, times: Sequence[float], values: Sequence[float], *, is_linear: bool) -> InputSchedule:
        """Return the schedule of an input with a value at each time, between which it is constant or linear.

        Times at which neither value nor rate changes are left out.
        """
        slopes = [0.0] * len(times)
        if is_linear:
            slopes[:-1] = (np.diff(values) / np.diff(times)).tolist()
        changes = [
            k
            for k, value in enumerate(values)
            if k == 0 or value != values[k - 1] or slopes[k] != 0.0 or slopes[k - 1] != 0.0
        ]
        return cls(*(tuple(column[k] for k in changes) for column in (times, values, slopes)))

    def last(self, time: float) -> int:
        """Return the index of the last setting until `time` [s]; -1 if there is none."""
        return bisect_right(self.times, time) - 1

    def at(self, index: int, time: float) -> float:
        """Return the value at `time` [s] after the setting with an index."""
        slope = self.slopes[index]
        return self.values[index] + slope * (time - self.times[index]) if slope else self.values[index]


@dataclass(frozen=True)
class Setting:
    """An input that was set: time [s], index of the input, and value."""

    time: float
    number: int
    value: float


def start_settings(mechanism: CompiledMechanism, t0: float) -> dict[str, np.ndarray]:
    """Return the arrays, by path, of the settings of inputs that keep their initial values from the time `t0` [s] on;
    none without inputs.
    """
    z = mechanism.initial_states
    settings = [Setting(t0, number, float(z[item.state])) for number, item in enumerate(mechanism.inputs)]
    rows = {"set/number": np.arange(1, len(settings) + 1), **setting_rows(mechanism, settings)}
    return {f"inputs/{name}": values for name, values in rows.items()} if settings else {}


def setting_rows(mechanism: CompiledMechanism, settings: Sequence[Setting]) -> dict[str, np.ndarray]:
    """Return settings as the arrays of the group ``inputs/set`` of archives."""
    of = [mechanism.inputs[setting.number] for setting in settings]
    return {
        "set/instant": np.array([setting.time for setting in settings]),
        "set/name": np.array([item.name for item in of], dtype=object),
        "set/row_units": np.array([item.unit for item in of], dtype=object),
        "set/value": np.array([setting.value for setting in settings]),
    }
