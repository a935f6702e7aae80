"""What an environment is: its spec, actions, observations and rewards, and what differs between its episodes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from mbdkit import load_spec
from mbdkit.plugin import RunSpec, SpecError, did_you_mean, listed, quoted
from mbdkit.plugin.measures import OPERATIONS, MeasureCompiler, RunExpression
from mbdkit.plugin.specs import RunSource
from mbdkit.plugin.studies import frozen

Actions = Sequence[str] | Mapping[str, Sequence[float]]
Observations = Sequence[str] | Mapping[str, str | Mapping[str, Any]]
Function = Callable[[Mapping[str, np.ndarray]], Any]
Values = Mapping[str, Any]  #: Numbers or distributions, by name of a parameter or of an initial quantity.


class Definition:
    """What an environment is; see `mbdkit_gym.Environment` for the arguments.

    Attributes
    ----------
    spec : RunSpec
        The spec, whose time ends one period after the longest episode.
    period, duration : float
        Time between two actions, and of the longest episode [s].
    actions, observations : dict
        The unit of each action and observation by name; empty where it is not known.
    expressions : list of str
        What is read after each period: the observations, and the expressions of reward and termination.
    action_space, observation_space : gymnasium.spaces.Box
        The spaces of one simulation.
    """

    def __init__(
        self, spec: RunSource, *, observations: Observations, reward: str | Function, period: float, duration: float,
        actions: Actions | None = None, terminated: str | Function | None = None, randomize: Values | None = None,
    ):  # fmt: skip
        self.period, self.duration = _time("period", period), _time("duration", duration)
        if self.duration < self.period:
            raise SpecError(f"the duration, {self.duration:g} s, is less than a period, {self.period:g} s")
        given = load_spec(spec, ())
        time = {"start": given.time.start, "end": given.time.start + self.duration + self.period}
        time |= {} if given.time.step is None else {"step": given.time.step}
        self.spec: RunSpec = load_spec(given, (), time=time)
        self._mechanism = self.spec.mechanism()
        self.low, self.high = self._action_bounds(actions)
        self.actions = {name: self._mechanism.inputs[name].unit for name in self._action_names}
        self.action_space = spaces.Box(self.low.astype(np.float32), self.high.astype(np.float32), dtype=np.float32)
        self.expressions: list[str] = []
        self.observations: dict[str, str] = {}
        bounds = [self._observe(name, given) for name, given in _named(observations).items()]
        self.observation_space = spaces.Box(*np.array(bounds, dtype=np.float64).T, dtype=np.float64)
        self._reward, self._terminated = self._judged("reward", reward), self._judged("terminated", terminated)
        self._fixed: dict[str, float | str] = {}
        self._drawn: dict[str, Any] = {}
        for name, value in (randomize or {}).items():
            if isinstance(value, int | float | str):
                self._fixed[name] = value
                continue
            with SpecError.locate(f"randomize.{quoted(name)}"):
                self._drawn[name] = frozen(value)

    def _action_bounds(self, actions: Actions | None) -> tuple[np.ndarray, np.ndarray]:
        inputs = self._mechanism.inputs
        if not inputs:
            raise SpecError("the mechanism has no inputs, which the actions would set", key="model.inputs")
        chosen = inputs if actions is None else actions
        self._action_names = list(chosen)
        own: Mapping[str, Any] = actions if isinstance(actions, Mapping) else {}
        bounds = []
        for name in chosen:
            if name not in inputs:
                hint = did_you_mean(name, inputs) or f"; inputs: {listed(inputs)}"
                raise SpecError(f"the mechanism has no input '{name}'{hint}", key="actions")
            pair = own.get(name, inputs[name].bounds)
            if pair is None:
                way = f"give them with the input, or as in actions={{{name!r}: [-1, 1]}}"
                raise SpecError(f"the action '{name}' needs bounds: {way}", key="actions")
            low, high = map(float, pair)
            widest = inputs[name].bounds or (-math.inf, math.inf)
            if not (widest[0] <= low < high <= widest[1] and math.isfinite(high - low)):
                within = "" if inputs[name].bounds is None else f" within {widest[0]:g} and {widest[1]:g}"
                raise SpecError(
                    f"should be finite bounds [smallest, largest]{within}, not {pair}", key=f"actions.{name}"
                )
            bounds.append((low, high))
        return tuple(np.array(bounds).T)

    def _observe(self, name: str, given: object) -> tuple[float, float]:
        """Add an observation, and return its bounds."""
        further: Mapping[str, Any] = given if isinstance(given, Mapping) else {"value": given}
        key = f"observations.{quoted(name)}"
        if wrong := [word for word in further if word not in ("value", "min", "max")]:
            raise SpecError(f"has `value`, `min` and `max`, not `{wrong[0]}`", key=key)
        text = further.get("value")
        if not isinstance(text, str):
            raise SpecError("should be an expression, or {value: EXPRESSION, min: NUMBER, max: NUMBER}", key=key)
        low, high = self._limits(text, key)
        self.expressions.append(text)
        try:
            unit = MeasureCompiler(text, self.spec).series()[1].unit
        except SpecError:  # of sums of different units, which are allowed here
            unit = None
        self.observations[name] = "" if unit is None else str(unit)
        return float(further.get("min", low)), float(further.get("max", high))

    def _limits(self, text: str, key: str) -> tuple[float, float]:
        """Return bounds that follow from the form of an expression; infinite ones for most."""
        parsed = self._parsed(text, key)
        operation = parsed.program[-1][0]
        if operation in ("cos", "sin", "tanh"):
            return -1.0, 1.0
        is_alone = len(parsed.program) == 1 and parsed.quantities
        if is_alone and parsed.quantities[0].kind == "inputs":
            return self._mechanism.inputs[parsed.quantities[0].name].bounds or (-math.inf, math.inf)
        is_positive = operation in OPERATIONS and OPERATIONS[operation].is_never_negative
        return (0.0 if is_positive else -math.inf), math.inf

    def _parsed(self, text: str, key: str) -> RunExpression:
        with SpecError.locate(key):
            return RunExpression.parse(text, self._mechanism, self.spec.numbers, crosses=False)

    def _judged(self, name: str, given: str | Function | None) -> Function | int | None:
        """Return a function, or the index of an expression that is read."""
        if not isinstance(given, str):
            if callable(given) or (given is None and name == "terminated"):
                return given
            raise SpecError(f"should be an expression or a function of the values by name, not {given!r}", key=name)
        self._parsed(given, name)
        self.expressions.append(given)
        return len(self.expressions) - 1

    @property
    def varied(self) -> set[str]:
        """Parameters and numbers of the model in which episodes may differ."""
        return {name for name in (*self._fixed, *self._drawn) if self._is_parameter(name)}

    def _is_parameter(self, name: str) -> bool:
        return name in self.spec.parameters or name.partition(".")[0] in ("model", "parameters")

    def start(self, random: np.random.Generator, given: Values | None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the parameters and initial quantities of an episode, some of which may be `given`."""
        drawn = {name: float(one.rvs(random_state=random)) for name, one in self._drawn.items()}
        values = self._fixed | drawn | dict(given or {})
        parameters = {name: value for name, value in values.items() if self._is_parameter(name)}
        for name in parameters.keys() - self.varied:
            raise SpecError("is a parameter that differs between episodes only if `randomize` names it", key=name)
        return parameters, {name: value for name, value in values.items() if name not in parameters}

    def clipped(self, actions: np.ndarray) -> np.ndarray:
        """Return actions (N, A) within their bounds; raise SpecError if they have another shape or are not finite."""
        given = np.asarray(actions, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.actions) or not np.isfinite(given).all():
            raise SpecError(f"an action should be {len(self.actions)} finite numbers: {listed(self.actions)}")
        return np.clip(given, self.low, self.high)

    def judged(self, values: np.ndarray, actions: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rewards (N,), and values (N,) that are positive where episodes have terminated, from what was read
        (N, K).
        """
        named: dict[str, np.ndarray] = {"t": time}
        if callable(self._reward) or callable(self._terminated):
            named |= zip(self.observations, values.T, strict=False)
            named |= zip(self.actions, actions.T, strict=True)
        count = len(values)

        def judged(given: Function | int) -> np.ndarray:
            result = values[:, given] if isinstance(given, int) else given(named)
            return np.broadcast_to(np.asarray(result, dtype=np.float64), (count,))

        ends = np.zeros(count) if self._terminated is None else judged(self._terminated)
        return judged(self._reward), ends  # type: ignore[arg-type]


def _time(name: str, given: object) -> float:
    if isinstance(given, int | float) and 0.0 < given < math.inf:
        return float(given)
    raise SpecError(f"should be a positive time in seconds, not {given!r}", key=name)


def _named(observations: object) -> Mapping[str, Any]:
    if isinstance(observations, Mapping) and observations:
        return observations
    if isinstance(observations, list | tuple) and observations:
        return {str(text): text for text in observations}
    raise SpecError("should be a list of expressions, or expressions by name", key="observations")
