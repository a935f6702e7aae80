"""An environment of Gymnasium: one simulation of a spec whose inputs are the actions."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from mbdkit.plugin import SpecError
from mbdkit.plugin.specs import RunSource
from mbdkit_gym.definition import Actions, Definition, Function, Observations, Values
from mbdkit_gym.episodes import Episodes

Array = NDArray[np.float64]


class Environment(gymnasium.Env[Array, NDArray[np.float32]]):
    """An environment whose episodes are simulations of a spec.

    In each step, the inputs of the mechanism are set to the action, and the simulation advances by one period. All
    values are in SI units.

    Parameters
    ----------
    spec
        A run spec, as for `mbdkit.run`; its integrator and `time.step` are used, its end time is not.
    actions
        Names of the inputs that the action consists of, or bounds ``[smallest, largest]`` by name; by default, all
        inputs with their own bounds. Actions beyond their bounds are clipped.
    observations
        Expressions of the state, such as ``"cos(pole.angle)"``, or expressions by name. In place of an expression,
        ``{"value": EXPRESSION, "min": NUMBER, "max": NUMBER}`` gives bounds of the observation space, which otherwise
        follow only for sines, cosines, tanh, inputs, and values that are never negative.
    reward
        An expression of the state at the end of the period, or a function. A function receives arrays (N,) by name, of
        the observations, the actions and the time ``t`` since the start of the episode, and returns an array (N,); N is
        1 here.
    terminated
        An expression or a function as for `reward`; the episode terminates where it is positive. It also terminates if
        the simulation cannot go on; ``info["ended"]`` then says why.
    period
        Time between two actions [s].
    duration
        Time after which an episode is truncated [s].
    randomize
        Numbers, or distributions as in studies, such as ``{"uniform": [-0.1, 0.1]}``, by name: parameters of the spec,
        keys of the model such as ``model.bodies.pole.mass``, and initial quantities such as ``pole.angle``.
    render_mode
        ``"rgb_array"``: `render` returns a picture.

    Raises
    ------
    SpecError
        If an argument is wrong.
    """

    def __init__(
        self,
        spec: RunSource,
        *,
        observations: Observations,
        reward: str | Function,
        period: float,
        duration: float,
        actions: Actions | None = None,
        terminated: str | Function | None = None,
        randomize: Values | None = None,
        render_mode: str | None = None,
    ):
        definition = Definition(
            spec, observations=observations, reward=reward, period=period, duration=duration, actions=actions,
            terminated=terminated, randomize=randomize,
        )  # fmt: skip
        if render_mode not in (None, "rgb_array"):
            raise SpecError(f"should be 'rgb_array' or None, not {render_mode!r}", key="render_mode")
        self.definition, self.render_mode = definition, render_mode
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": max(1, round(1.0 / definition.period))}
        self.action_space, self.observation_space = definition.action_space, definition.observation_space
        self._frames = _Frames(definition) if render_mode == "rgb_array" else None
        self._episodes = Episodes(definition, 1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode; `options` are values that replace those of `randomize`."""
        super().reset(seed=seed)
        return self._episodes.start([0], [self.np_random], options)[0], {"t": 0.0}

    def step(self, action: NDArray[np.float32]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Set the inputs to the action, and advance by one period."""
        result = self._episodes.step(np.asarray(action)[None], np.zeros(1, dtype=bool), [])
        simulations = self._episodes.simulations
        info: dict[str, Any] = {"t": float(simulations.time[0])}
        if ended := simulations.ended:
            info["ended"] = ended[0]
        observation, reward, terminated, truncated = (values[0] for values in result)
        return observation, float(reward), bool(terminated), bool(truncated), info

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the present state, (height, width, 3), if `render_mode` is ``"rgb_array"``."""
        return None if self._frames is None else self._frames.picture(self._episodes.values[0])

    def close(self) -> None:
        """Give up the simulation."""
        self._episodes.simulations.close()


class _Frames:
    """Draws states of the mechanism of an environment; adds the poses of the bodies to what is read."""

    def __init__(self, definition: Definition):
        from mbdkit.plugin.reports import PosePictures  # Matplotlib takes long to import

        mechanism = definition.spec.mechanism()
        self._pictures = PosePictures(mechanism, definition.spec.title or "")
        self._columns = []
        for number, (name, body) in enumerate(mechanism.bodies.items()):
            axes = ("x", "y") if body.inertia is None else ("x", "y", "angle")
            for axis, coordinate in enumerate(axes):
                self._columns.append((number, axis, len(definition.expressions)))
                definition.expressions.append(f'bodies["{name}"].{coordinate}')
        self._bodies = len(mechanism.bodies)

    def picture(self, values: np.ndarray) -> NDArray[np.uint8]:
        """Return the picture of a state, (height, width, 3), from the values of all expressions that are read."""
        pose = np.zeros((self._bodies, 3))
        for body, axis, column in self._columns:
            pose[body, axis] = values[column]
        return self._pictures.draw(pose)
