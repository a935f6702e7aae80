"""Episodes of N simulations: their starts, steps, rewards and ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdkit import RunError
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
            self.simulations.start(which, [self.definition.start(generator, given) for generator in random])
        return self._observed()

    def _observed(self) -> np.ndarray:
        """Read the present states, and return observations; in those of a simulation that has ended, the ones before
        stand for values that are not finite.
        """
        self.values = self.simulations.read()
        seen = self.values[:, : self._count]
        if not np.isfinite(seen).all():
            for name, values in zip(self.definition.observations, seen.T, strict=True):
                self._require_finite(f"the observation '{name}'", values)
        self._last = np.where(np.isfinite(seen), seen, self._last)
        return self._last.copy()

    def _require_finite(self, name: str, values: np.ndarray, over: np.ndarray | bool = False) -> None:
        """Raise RunError if values (N,) of simulations that go on, and whose episode is not `over`, are not finite."""
        wrong = {*np.flatnonzero(~np.isfinite(values) & ~np.asarray(over)).tolist()} - self.simulations.ended.keys()
        if wrong:
            i = min(wrong)
            where = f" in environment {i}" if self.number > 1 else ""
            when = f"at t = {self.simulations.time[i]:.6g} s{where}"
            raise RunError(f"{name} is {values[i]:g} {when}; give an expression that is defined in all states")

    def step(self, actions: np.ndarray, over: np.ndarray, random: Sequence[np.random.Generator]) -> Outcome:
        """Advance by one period; simulations whose episode is `over` (N,) start a new one instead."""
        definition, simulations = self.definition, self.simulations
        actions = definition.clipped(actions)
        simulations.advance(actions, ~over)
        again = np.flatnonzero(over).tolist()
        if again:
            simulations.start(again, [definition.start(random[i], None) for i in again])
        observations, time = self._observed(), simulations.time
        rewards, ends = definition.judged(self.values, actions, time)
        for name, values in (("the reward", rewards), ("`terminated`", ends)):
            self._require_finite(name, values, over)
        terminated = ends > 0.0
        terminated[[*simulations.ended]] = True
        truncated = time >= definition.duration - 0.5 * definition.period
        rewards = np.where(over | ~np.isfinite(rewards), 0.0, rewards)
        return Outcome(observations, rewards, terminated & ~over, truncated & ~over)
