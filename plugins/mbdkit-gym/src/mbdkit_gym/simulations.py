"""The simulations of an environment: in a batch where the vectorized loop takes the spec, otherwise one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import mbdkit
from mbdkit import RunError
from mbdkit.plugin.runs import SimulationBatch
from mbdkit.plugin.specs import parameters_in_use
from mbdkit_gym.definition import Definition

Start = tuple[dict[str, Any], dict[str, Any]]  #: Parameters and initial quantities by name.


def simulations_of(definition: Definition, number: int) -> Simulations:
    """Return `number` simulations of an environment, in a batch if that is possible."""
    return _Turns(definition, number) if why_in_turn(definition) else _Batch(definition, number)


def why_in_turn(definition: Definition) -> str:
    """Return the reason why simulations of an environment advance one after another, as a clause, or an empty text."""
    spec, step = definition.spec, definition.spec.time.step
    if step is None or abs(definition.period / step - round(definition.period / step)) > 1e-9:
        return "the period is not a multiple of `time.step`"
    used = parameters_in_use(spec.parameters, definition.expressions)
    if {name.removeprefix("parameters.") for name in definition.varied} & used:
        return "an expression contains a parameter that differs between episodes"
    return SimulationBatch.why_not(spec)


class _Batch:
    """N simulations in lanes; see `_Turns` for its methods."""

    def __init__(self, definition: Definition, number: int):
        spec = definition.spec
        self._definition, self._prepared = definition, mbdkit.prepare(spec)
        self._batch = SimulationBatch(spec, number, apart=bool(definition.varied))
        assert spec.time.step is not None
        self._steps = round(definition.period / spec.time.step)
        names = [one.name for one in self._batch.mechanism.inputs]
        self._places = [names.index(name) for name in definition.actions]
        self.read, self.close = self._batch.reader(definition.expressions), self._batch.close
        self._started = False

    def start(self, which: Sequence[int], starts: Sequence[Start]) -> None:
        if not self._started:  # refuses joints that would move with the start
            self._prepared.spec_with(*starts[0])
            self._started = True
        mechanisms, q, v = zip(*(self._prepared.start_with(*start) for start in starts), strict=True)
        self._batch.start(which, np.array(q), np.array(v), mechanisms if self._batch.apart else None)

    def advance(self, actions: np.ndarray, which: np.ndarray) -> None:
        self._batch.inputs[:, self._places] = actions
        self._batch.advance(self._steps)

    @property
    def time(self) -> np.ndarray:
        return self._batch.time - self._definition.spec.time.start

    @property
    def ended(self) -> dict[int, str]:
        lost = np.flatnonzero(self._batch.lost).tolist()
        return dict.fromkeys(lost, "the state is not finite, or the joints fall apart.")


class _Turns:
    """N open simulations that advance one after another."""

    def __init__(self, definition: Definition, number: int):
        self._definition = definition
        self._simulations = [mbdkit.open(definition.spec) for _ in range(number)]
        self._readers = [simulation.reader(definition.expressions) for simulation in self._simulations]

    def start(self, which: Sequence[int], starts: Sequence[Start]) -> None:
        """Start some simulations anew."""
        for i, (parameters, initial) in zip(which, starts, strict=True):
            self._simulations[i].reset(parameters=parameters, initial=initial)

    def advance(self, actions: np.ndarray, which: np.ndarray) -> None:
        """Set the actions (N, A), and advance by a period, at least those of `which` (N,) that have not ended."""
        for i in np.flatnonzero(which).tolist():
            simulation = self._simulations[i]
            if not simulation.ended:
                simulation.inputs.update(zip(self._definition.actions, actions[i].tolist(), strict=True))
                try:
                    simulation.advance(self._definition.period)
                except RunError:
                    continue  # `ended` says why

    def read(self) -> np.ndarray:
        """Return the values (N, K) of the expressions of the definition."""
        return np.array([read() for read in self._readers])

    def close(self) -> None:
        """Give up the simulations."""
        self._simulations.clear()

    @property
    def time(self) -> np.ndarray:
        """(N,) times since the start of the episode [s]."""
        return np.array([one.time for one in self._simulations]) - self._definition.spec.time.start

    @property
    def ended(self) -> dict[int, str]:
        """Why simulations cannot go on, as sentences, by their number; empty while all can."""
        return {i: simulation.ended for i, simulation in enumerate(self._simulations) if simulation.ended}


Simulations = _Batch | _Turns  #: The simulations of an environment.
