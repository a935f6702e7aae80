"""Sampled controllers and inputs: the values that they hold, and how these change at a stop.

The outputs and states of controllers are first-order states with the rate 0, and so are inputs, or their rates if they
change linearly. Steps end at the times of samples, at the times at which outputs begin to apply, and at the times at
which inputs are set. The values change there, before the next step: first those of inputs, which samples then use.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mbdkit.engine.compiled_mechanism import SampledController
from mbdkit.engine.input_schedule import InputSchedule, Setting, same_time
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.kernels.table_rows import STATE_ROW
from mbdkit.engine.native.calls import call_law
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import Failure

#: Largest difference, as a share of the period, between the time of a stop and that of a sample that count as equal.
SAME = 1e-6


class Sampler:
    """Updates the values that controllers hold, and those of inputs.

    Parameters
    ----------
    workspace
        The mechanism, its start and the schedules of its inputs; its working arrays are used.
    samples
        Stops at which outputs of controllers change [s], other than the start.

    Attributes
    ----------
    schedules
        The schedule of each input. It may be replaced by a longer one to set the input at later stops.
    set_states
        Indices of the first-order states of inputs that were set at the last stop.
    """

    def __init__(self, workspace: Workspace, samples: Iterable[float] = ()):
        self._workspace, self._controllers = workspace, workspace.mechanism.controllers
        self._pending = [np.zeros((_pending(controller), len(controller.outputs))) for controller in self._controllers]
        self._samples = frozenset((workspace.t0, *samples))
        self._last = -math.inf
        self._inputs = workspace.mechanism.inputs
        self.schedules = list(workspace.schedules or [InputSchedule()] * len(self._inputs))
        self._settings: list[Setting] = []
        self._samples_taken: list[tuple[float, int, float]] = []  # time, state and value
        self._latest = [-1] * len(self._inputs)  # index of the last setting of each input
        self.set_states: list[int] = []
        #: Whether there are values to update.
        self.is_needed = bool(self._controllers or self._inputs)
        held = np.flatnonzero(workspace.mechanism.topology.states[:, STATE_ROW.rate] < 0)
        #: Indices of the first-order states that change at stops.
        self.held = np.union1d(held, [item.state for item in self._inputs]).astype(np.int64)

    def passed(self, stop: float, q: np.ndarray, v: np.ndarray, z: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Return the first-order states after the changes at a time; a repeated call has no effect.

        Parameters
        ----------
        stop
            The time [s]: the start or a stop.
        q, v
            (3 (B + 1),) positions and velocities.
        z
            (Z,) first-order states before the changes.
        margin
            Margin of the stop [s]. Inputs that are set up to this time after it are set at the stop.
        """
        after = z.copy()
        if stop <= self._last:
            return after
        self._set_inputs(stop, stop + margin, after)
        self._last = stop
        return self._sampled(stop, q, v, after) if stop in self._samples else after

    def _set_inputs(self, stop: float, until: float, z: np.ndarray) -> None:
        """Set inputs in the first-order states `z`; those at the start are set in any case."""
        is_start = math.isinf(self._last)
        self.set_states = []
        for number, (item, schedule) in enumerate(zip(self._inputs, self.schedules, strict=True)):
            index = schedule.last(until + same_time(until))
            if index > self._latest[number]:
                self._latest[number] = index
                self.set_states += [item.state, item.slope] if item.is_linear else [item.state]
                z[item.state] = schedule.at(index, stop) if is_start else schedule.values[index]
                if item.is_linear:
                    z[item.slope] = schedule.slopes[index]
            elif not is_start:
                continue
            self._settings.append(Setting(stop, number, float(z[item.state])))

    def taken(self) -> list[Setting]:
        """Return the settings of inputs since the last call, in order of time; first, the values at the start."""
        taken, self._settings = self._settings, []
        return taken

    def ends(self, time: float) -> list[Setting]:
        """Return the values at the end of the run, at `time` [s], of inputs that are then changing linearly."""
        ends = []
        for number, (index, schedule) in enumerate(zip(self._latest, self.schedules, strict=True)):
            if index >= 0 and schedule.slopes[index] != 0.0 and time > self._last:
                ends.append(Setting(time, number, schedule.at(index, time)))
        return ends

    def _sampled(self, stop: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the first-order states after the samples of controllers at a time."""
        after, is_evaluated = z.copy(), False
        for controller, pending in zip(self._controllers, self._pending, strict=True):
            number = self._number(stop, controller, 0.0)
            if number is not None:
                if not is_evaluated:
                    self._evaluate(stop, q, v, z)
                    is_evaluated = True
                pending[number % len(pending)] = self._outputs(controller, number, stop)
                for state, row in controller.states:
                    after[state] = self._value(row, stop)
            number = self._number(stop, controller, controller.delay)
            if number is not None:
                after[[state for state, _ in controller.outputs]] = pending[number % len(pending)]
        return after

    def _outputs(self, controller: SampledController, number: int, t: float) -> list[float]:
        """Return the outputs of a sample, by their number, at time `t` [s]; requires `_evaluate`."""
        if not controller.python:
            return [self._value(row, t) for _, row in controller.outputs]
        if self._workspace.python is None:
            return [0.0] * len(controller.outputs)
        values = {name: self._value(row, t) for name, row in controller.arguments}
        outputs = self._workspace.python.outputs(controller, number, t, values)
        if self.failure is None:
            states = [state for state, _ in controller.outputs]
            self._samples_taken += [(t, state, value) for state, value in zip(states, outputs, strict=True)]
        return outputs

    @property
    def failure(self) -> Failure | None:
        """Why the function of a controller has failed; None if none has."""
        python = self._workspace.python
        return Failure("controller-error", f"{python.failure}.") if python is not None and python.failure else None

    def taken_samples(self) -> dict[str, np.ndarray]:
        """Return the outputs of controllers in Python since the last call, as arrays of the group ``samples``."""
        taken, self._samples_taken = self._samples_taken, []
        states = [self._workspace.mechanism.states[state] for _, state, _ in taken]
        return {
            "time": np.array([time for time, *_ in taken]),
            "output": np.array([state.name for state in states], dtype=object),
            "row_units": np.array([state.unit for state in states], dtype=object),
            "value": np.array([value for *_, value in taken]),
        }

    def _number(self, stop: float, controller: SampledController, delay: float) -> int | None:
        """Return the number of the sample taken `delay` [s] before the time `stop`; None if there is none."""
        begin = self._workspace.t0 + delay
        number = round((stop - begin) / controller.period)
        is_there = number >= 0 and abs(begin + number * controller.period - stop) <= SAME * controller.period
        return number if is_there else None

    def _evaluate(self, t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> None:
        workspace = self._workspace
        workspace.take_states(z)
        acc, lam = np.zeros(len(q)), np.zeros((len(workspace.mechanism.topology.pairs), 2))
        tangents_at(workspace.engine, t, q, v, acc, lam)

    def _value(self, row: int, t: float) -> float:
        address, first, _, program = (int(x) for x in self._workspace.mechanism.topology.laws[row])
        out = np.zeros((1, 4))
        call_law(address, program, 0.0, 0.0, t, self._workspace.scratch.law_values, first, out, 0, 4)
        return float(out[0, 0])

    def stored(self) -> dict[str, Any]:
        """Return the state of the sampler as plain values, after all settings and samples have been taken."""
        return {"pending": [values.tolist() for values in self._pending], "last": self._last, "latest": self._latest}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a stored state."""
        for own, given in zip(self._pending, state["pending"], strict=True):
            own[...] = np.array(given, dtype=float).reshape(own.shape)
        self._last = float(state["last"])
        self._latest[:] = map(int, state["latest"])
        self._settings, self._samples_taken = [], []


def _pending(controller: SampledController) -> int:
    """Return the largest number of samples whose outputs do not apply yet."""
    return math.floor(controller.delay / controller.period + SAME) + 1


def sample_times(periods: Iterable[tuple[float, float]], start: float, end: float) -> list[float]:
    """Return the times after `start` and before `end` at which the values that controllers hold change [s].

    Parameters
    ----------
    periods
        Period and delay of each controller [s].
    """
    times: list[float] = []
    for period, delay in periods:
        for begin in {start, start + delay}:
            count = math.ceil((end - begin) / period)
            times += [begin + number * period for number in range(count)]
    return sorted(time for time in times if start < time < end)


def states_at_start(workspace: Workspace) -> np.ndarray:
    """Return the first-order states at the start of a run (Z,), with inputs set and after the first samples."""
    z = workspace.mechanism.initial_states
    return Sampler(workspace).passed(workspace.t0, workspace.q0, workspace.v0, z) if len(z) else z
