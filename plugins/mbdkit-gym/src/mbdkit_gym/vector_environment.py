"""A vector environment of Gymnasium: many simulations of a spec that advance together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mbdkit.plugin import SpecError
from mbdkit.plugin.specs import RunSource
from mbdkit_gym.definition import Definition
from mbdkit_gym.episodes import Episodes
from mbdkit_gym.simulations import why_in_turn

Array = NDArray[np.float64]


class VectorEnvironment(VectorEnv[Array, NDArray[np.float32], Array]):
    """`number` environments of one spec, each with the same results as an `Environment` with its seed.

    The arguments are those of `Environment`. An environment whose episode has ended starts a new one in the next step,
    without regard to its action and with the reward 0 (``AutoresetMode.NEXT_STEP``).

    Attributes
    ----------
    why_in_turn : str
        Why the simulations advance one after another, as a clause; empty if one call of compiled code advances all.
    """

    def __init__(self, spec: RunSource, *, number: int, **arguments: Any):
        if not isinstance(number, int) or number < 1:
            raise SpecError(f"should be a positive number of environments, not {number!r}", key="number")
        definition = Definition(spec, **arguments)
        self.definition, self.num_envs = definition, number
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self.single_action_space, self.single_observation_space = definition.action_space, definition.observation_space
        self.action_space = batch_space(definition.action_space, number)
        self.observation_space = batch_space(definition.observation_space, number)
        self.why_in_turn = why_in_turn(definition)
        self._episodes = Episodes(definition, number)
        self._over = np.zeros(number, dtype=bool)
        self._random = [np_random(None)[0] for _ in range(number)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start episodes of all environments; environment i has the seed ``seed + i``, or ``seed[i]``."""
        if seed is not None:
            seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
            for i, one in enumerate(seeds):
                if one is not None:
                    self._random[i] = np_random(one)[0]
        self._over[:] = False
        observations = self._episodes.start(range(self.num_envs), self._random, options)
        return observations, {"t": np.zeros(self.num_envs), "_t": np.ones(self.num_envs, dtype=bool)}

    def step(self, actions: NDArray[np.float32]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Set the inputs to the actions (number, A), and advance all environments by one period."""
        result = self._episodes.step(np.asarray(actions), self._over, self._random)
        self._over = result.terminated | result.truncated
        simulations = self._episodes.simulations
        infos: dict[str, Any] = {"t": simulations.time, "_t": np.ones(self.num_envs, dtype=bool)}
        if ended := simulations.ended:
            why = np.array([ended.get(i, "") for i in range(self.num_envs)], dtype=object)
            infos |= {"ended": why, "_ended": why != ""}
        return (*result, infos)

    def close_extras(self, **kwargs: Any) -> None:
        """Give up the simulations."""
        self._episodes.simulations.close()
