"""Sampled controllers: the values that they hold between samples, and how these change at a sample.

The outputs and states of controllers are first-order states with the rate 0. Steps end at the times of samples and at
the times at which outputs begin to apply. The values change there, before the next step.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mbdkit.engine.compiled_mechanism import SampledController
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.native.calls import call_law
from mbdkit.engine.workspace import Workspace

SAME = 1e-6
"""Largest difference, as a share of the period, between the time of a stop and that of a sample that count as equal."""


class Sampler:
    """Updates the values that controllers hold.

    Parameters
    ----------
    workspace
        The mechanism and its start; its working arrays are used.
    """

    def __init__(self, workspace: Workspace):
        self._workspace, self._controllers = workspace, workspace.mechanism.controllers
        self._pending = [np.zeros((_pending(controller), len(controller.outputs))) for controller in self._controllers]
        self._last = -math.inf

    def passed(self, stop: float, q: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return the first-order states after the samples at a time; a repeated call has no effect.

        Parameters
        ----------
        stop
            The time [s].
        q, v
            (3 (B + 1),) positions and velocities.
        z
            (Z,) first-order states before the samples.
        """
        after = z.copy()
        if stop <= self._last:
            return after
        self._last = stop
        is_evaluated = False
        for controller, pending in zip(self._controllers, self._pending, strict=True):
            number = self._number(stop, controller, 0.0)
            if number is not None:
                if not is_evaluated:
                    self._evaluate(stop, q, v, z)
                    is_evaluated = True
                pending[number % len(pending)] = [self._value(row, stop) for _, row in controller.outputs]
                for state, row in controller.states:
                    after[state] = self._value(row, stop)
            number = self._number(stop, controller, controller.delay)
            if number is not None:
                after[[state for state, _ in controller.outputs]] = pending[number % len(pending)]
        return after

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
        """Return the state of the sampler as plain values."""
        return {"pending": [values.tolist() for values in self._pending], "last": self._last}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a stored state."""
        for own, given in zip(self._pending, state["pending"], strict=True):
            own[...] = np.array(given, dtype=float).reshape(own.shape)
        self._last = float(state["last"])


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
    """Return the first-order states at the start of a run (Z,), after the first samples."""
    z = workspace.mechanism.initial_states
    return Sampler(workspace).passed(workspace.t0, workspace.q0, workspace.v0, z) if len(z) else z
