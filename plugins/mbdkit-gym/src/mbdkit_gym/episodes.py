"""Episodes of N simulations: their starts, steps, rewards and ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdkit_gym.definition import Definition, Values
from mbdkit_gym.simulations import simulations_of


class Outcome(NamedTuple):
    """What a step gives, for each of N simulations."""

    observations: np.ndarray
    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


class Episodes:
    """Episodes of N simulations, with a generator of random numbers for each."""

    def __init__(self, definition: Definition, number: int):
        self.definition, self.number = definition, number
        self.simulations = simulations_of(definition, number)
        self._count = len(definition.observations)
        self._last = np.zeros((number, self._count))
        self.values = np.zeros((number, len(definition.expressions)))

    def start(
        self, which: Sequence[int], random: Sequence[np.random.Generator], given: Values | None = None
    ) -> np.ndarray:
        """Start episodes of some simulations, and return the observations (N, n) of all."""
        if len(which):
            starts = [self.definition.start(generator, given) for generator in random]
            self.simulations.start(which, starts)
        return self._observed()

    def _observed(self) -> np.ndarray:
        """Read the present states, and return observations; where one is not finite, the one before stands for it."""
        self.values = self.simulations.read()
        seen = self.values[:, : self._count]
        self._last = np.where(np.isfinite(seen), seen, self._last)
        return self._last.copy()

    def step(self, actions: np.ndarray, over: np.ndarray, random: Sequence[np.random.Generator]) -> Outcome:
        """Advance by one period; simulations whose episode is `over` (N,) start a new one instead."""
        definition, simulations = self.definition, self.simulations
        actions = definition.clipped(actions)
        simulations.advance(actions, ~over)
        again = np.flatnonzero(over).tolist()
        if again:
            simulations.start(again, [definition.start(random[i], None) for i in again])
        observations, time = self._observed(), simulations.time
        rewards, terminated = definition.judged(self.values, actions, time)
        terminated[[*simulations.ended]] = True
        truncated = time >= definition.duration - 0.5 * definition.period
        rewards = np.where(over | ~np.isfinite(rewards), 0.0, rewards)
        return Outcome(observations, rewards, terminated & ~over, truncated & ~over)
