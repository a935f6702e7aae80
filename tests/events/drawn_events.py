"""Drawn runs with events on motions in closed form, and their crossings by a finder of its own.

A body in free flight, a state with constant rate, a driver along a polygonal chain, and a sampled controller have
motions in closed form, also with states that events set. An expression is a product of factors whose zeros, poles and
jumps have known times. Between them, the sign of the expression is evaluated in the middle; a crossing is a time at
which it differs on both sides, except at a pole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from random import Random
from typing import Any

import mbdkit
from tests.integrators.python_methods import Pair, Rk45
from tests.integrators.python_methods import run_with as run_with_python
from tests.integrators.step_methods import Remembering, RungeKutta

G = 9.81
END = 3.0
APART = 0.02
"""Smallest time between the zeros of different factors [s]; pairs of zeros of one factor can be closer."""

TIGHT = {"rtol": 1e-11, "atol": 1e-11}
FIXED: list[Any] = [
    *({"name": name} for name in ("rk4", "rk-gill", "dopri5", "dop853", "radau-iia")),
    *({"name": "gauss", "stages": stages} for stages in (1, 2, 3)),
    lambda: Pair(None),
]  # fmt: skip
ADAPTIVE: list[Any] = [
    *({"name": name, "adaptive": True, **TIGHT} for name in ("dopri5", "dop853", "radau-iia", "gauss")),
    *({"name": f"scipy-{name}", **TIGHT} for name in ("dop853", "radau", "lsoda")),
    lambda: Pair(1e-9), Rk45,
]  # fmt: skip
WITHOUT_STATES = [{"name": "rattle"}, {"name": "lobatto-pair"}, {"name": "taylor"}, RungeKutta, Remembering]

Time = float
State = dict[str, float]
"""Values of the time and of all quantities by name."""


@dataclass(frozen=True)
class Factor:
    """A factor of an expression.

    Attributes
    ----------
    text
        The factor as written in a spec.
    value
        The factor as a function of the state.
    zeros, poles
        Positions on the axis of time at which the factor may change its sign, from the motion before `END`.
    """

    text: str
    value: Callable[[State], float]
    zeros: Callable[[Segment], list[Time]]
    poles: Callable[[Segment], list[Time]] = lambda segment: []


@dataclass(frozen=True)
class Segment:
    """A part of the motion without jumps: its begin and end [s], and the quantities as polynomials of t - begin."""

    begin: Time
    end: Time
    quantities: dict[str, tuple[float, ...]]

    def state(self, t: Time) -> State:
        """Return the state at a time [s]."""
        s = t - self.begin
        values = {name: sum(c * s**k for k, c in enumerate(cs)) for name, cs in self.quantities.items()}
        return values | {"t": t}

    def reached(self, name: str, level: float) -> list[Time]:
        """Return the times at which a quantity has a value."""
        c, b, a = (*(self.quantities | {"t": (self.begin, 1.0)})[name], 0.0, 0.0)[:3]
        c -= level
        if a == 0.0:
            roots = [-c / b] if b else []
        else:
            square = b * b - 4 * a * c
            half = -0.5 * (b + math.copysign(math.sqrt(max(square, 0.0)), b))
            roots = [half / a, c / half] if square > 0.0 else []
        return [self.begin + s for s in roots]


@dataclass
class DrawnEvent:
    """An event of a drawn run, as a product of factors."""

    name: str
    factors: list[Factor]
    direction: str = "any"
    action: str = "note"
    sets: dict[str, tuple[str, Callable[[State], float]]] = field(default_factory=dict)

    @property
    def spec(self) -> dict[str, Any]:
        """The event as in a spec."""
        when = " * ".join(f"({factor.text})" for factor in self.factors)
        more = {"set": {name: text for name, (text, _) in self.sets.items()}} if self.sets else {"action": self.action}
        return {"when": when, "direction": self.direction, **more}

    def sign(self, state: State) -> int:
        """Return the sign of the expression."""
        value = math.prod(math.copysign(1.0, factor.value(state)) for factor in self.factors)
        return 1 if value > 0 else -1

    def counts(self, direction: int) -> bool:
        """Return whether crossings in a direction are events."""
        return self.direction in ("any", "rising" if direction > 0 else "falling")


def power(name: str, level: float, exponent: int) -> Factor:
    """Return a factor with one zero or pole, which may be multiple: (name - level)**exponent."""
    at: Callable[[Segment], list[Time]] = lambda segment: segment.reached(name, level)  # noqa: E731
    none: Callable[[Segment], list[Time]] = lambda segment: []  # noqa: E731
    text = f"({name} - {level!r})" if level >= 0 else f"({name} + {-level!r})"
    written = f"1/{text}**{-exponent}" if exponent < 0 else f"{text}**{exponent}" if exponent > 1 else text
    return Factor(
        written,
        lambda state: (state[name] - level) ** (exponent % 2 or 2),
        none if exponent < 0 else at,
        at if exponent < 0 else none,
    )


def dip(name: str, level: float, half: float, form: str) -> Factor:
    """Return a factor that is negative where a quantity is closer to a level than `half`: a parabola, or a kink."""
    text = (
        f"({name} - ({level!r}))**2 - {half * half!r}" if form == "square" else f"abs({name} - ({level!r})) - {half!r}"
    )
    return Factor(
        text,
        lambda state: abs(state[name] - level) - half,
        lambda segment: segment.reached(name, level - half) + segment.reached(name, level + half),
    )


def wave(name: str, rate: float, phase: float, exponent: int) -> Factor:
    """Return sin(rate name + phase)**exponent, of a quantity that is linear in time."""

    def zeros(segment: Segment) -> list[Time]:
        values = sorted(rate * segment.state(t)[name] + phase for t in (segment.begin, segment.end))
        numbers = range(math.floor(values[0] / math.pi) - 1, math.ceil(values[1] / math.pi) + 2)
        return [t for k in numbers for t in segment.reached(name, (k * math.pi - phase) / rate)]

    text = f"sin({rate!r}*{name} + {phase!r})" + f"**{exponent}" * (exponent > 1)
    return Factor(text, lambda state: math.sin(rate * state[name] + phase) ** (exponent % 2 or 2), zeros)


def larger(names: Sequence[str], levels: Sequence[float], operation: str) -> Factor:
    """Return the larger or the smaller of two differences."""
    one, other = (f"{name} - ({level!r})" for name, level in zip(names, levels, strict=True))
    choose = max if operation == "max" else min
    return Factor(
        f"{operation}({one}, {other})",
        lambda state: choose(state[name] - level for name, level in zip(names, levels, strict=True)),
        lambda segment: [t for name, level in zip(names, levels, strict=True) for t in segment.reached(name, level)],
    )


@dataclass
class Case:
    """A drawn run: its spec, the method, and the crossings that are expected."""

    number: int
    method: Any
    spec: dict[str, Any]
    events: list[DrawnEvent]
    expected: list[tuple[Time, str, int]] = field(default_factory=list)
    end: Time = END

    def run(self) -> mbdkit.Run:
        """Carry out the run."""
        if isinstance(self.method, dict):
            return mbdkit.run(self.spec | {"mbdkit": 1, "integrator": self.method})
        return run_with_python(self.method(), **self.spec)

    def faults(self, within: float = 1e-7) -> list[str]:
        """Run the case; return what differs from what is expected."""
        try:
            run = self.run()
        except Exception as error:  # every exception is a fault
            return [f"{type(error).__name__}: {error}"]
        found = [] if run.status == "complete" else [f"{run.status}: {run.status_reason}"]
        if abs(run.time[-1] - self.end) > within:
            found.append(f"it ends at {run.time[-1]!r} instead of {self.end!r}")
        recorded = [(one.time, one.name, one.direction) for one in run.events]
        for wanted in self.expected:
            near = [one for one in recorded if one[1:] == wanted[1:] and abs(one[0] - wanted[0]) <= within]
            if near:
                recorded.remove(near[0])
            else:
                found.append(f"lost {wanted}")
        return found + [f"invented {one}" for one in recorded]


class AmbiguousError(Exception):
    """Two crossings are too close to each other, or to the end, for an answer that rounding errors cannot change."""


MOST_JUMPS = 60


class Finder:
    """Finds the crossings of events on a motion with jumps, instant by instant."""

    def __init__(self, events: Sequence[DrawnEvent], own_jumps: Sequence[Time], motion: Motion):
        self.events, self.jumps, self.motion = events, [*own_jumps, END], motion
        self.crossings: list[tuple[Time, str, int]] = []
        self.end = END

    def find(self) -> None:
        """Find all crossings until the end of the run; raise AmbiguousError if rounding errors may decide."""
        motion = self.motion
        signs = [event.sign(motion.segment(0.0, END).state(1e-9)) for event in self.events]
        begin = 0.0
        for stop in self.jumps:
            while begin < stop:
                segment = motion.segment(begin, stop)
                changes = sorted(
                    (t, number, is_pole)
                    for number, event in enumerate(self.events)
                    for t, is_pole in _changes(event, segment, signs[number])
                )
                times = [segment.begin, *(t for t, *_ in changes), stop]
                if any(0.0 < b - a < 1e-6 for a, b in pairwise(times) if b != a):
                    raise AmbiguousError
                jump = stop
                for t in dict.fromkeys(t for t, *_ in changes):
                    here = [(number, is_pole) for at, number, is_pole in changes if at == t]
                    acting = self._cross(t, here, signs)
                    if self.end < END:
                        return
                    if acting:
                        motion.set(t, acting)
                        self._jump(t, signs, acting)
                        jump = t
                        break
                else:
                    if stop < END:
                        motion.pass_jump(stop)
                        self._jump(stop, signs, [])
                if self.end < END:
                    return
                begin = jump

    def _cross(self, t: Time, here: list[tuple[int, bool]], signs: list[int]) -> list[DrawnEvent]:
        """Note the crossings at a time; return the events that set states."""
        for number, _ in here:
            signs[number] = -signs[number]
        counted = [n for n, is_pole in here if not is_pole and self.events[n].counts(signs[n])]
        for number in sorted(counted, key=lambda n: self.events[n].action == "stop"):
            self.crossings.append((t, self.events[number].name, signs[number]))
            if self.events[number].action == "stop":
                self.end = t
                return []
        return [self.events[number] for number in counted if self.events[number].sets]

    def _jump(self, t: Time, signs: list[int], setting: Sequence[DrawnEvent]) -> None:
        """Compare the signs after a jump with those before, until no event sets states."""
        fired = {event.name for event in setting}
        while True:
            after = self.motion.segment(t, END).state(t)
            here = []
            for number, event in enumerate(self.events):
                is_zero = any(abs(factor.value(after)) <= 1e-9 for factor in event.factors)
                sign = signs[number] if is_zero else event.sign(after)
                if sign != signs[number]:
                    if event in setting:
                        signs[number] = sign
                    else:
                        here.append((number, False))
            setting = self._cross(t, here, signs)
            if not setting or self.end < END:
                return
            if fired & {event.name for event in setting}:
                raise AmbiguousError  # it sets states without end
            fired |= {event.name for event in setting}
            self.motion.set(t, setting)
            if len(self.crossings) > MOST_JUMPS:
                raise AmbiguousError


def _changes(event: DrawnEvent, segment: Segment, sign: int) -> list[tuple[Time, bool]]:
    """Return the times within a segment at which an expression changes its sign, and whether this is at a pole."""
    zeros = {t: False for factor in event.factors for t in factor.zeros(segment)}
    poles = {t: True for factor in event.factors for t in factor.poles(segment)}
    every = sorted(t for factor in event.factors for t in (*factor.zeros(segment), *factor.poles(segment)))
    if any(b - a < 1e-6 for a, b in pairwise(every)):
        raise AmbiguousError
    jumps = [t for t in (segment.begin, segment.end) if 0.0 < t < END]
    if any(abs(pole - t) < 1e-6 for pole in poles for t in jumps):
        raise AmbiguousError  # there is no value before the jump
    ends = segment.begin - 1e-9, segment.end + 1e-9
    times = sorted(t for t in zeros | poles if ends[0] < t < ends[1])
    if times and (times[0] < segment.begin + 1e-6 or END - 1e-6 < times[-1] < END + 1e-6):
        times = [t for t in times if abs(t - segment.begin) > 1e-9]
        if times and (times[0] < segment.begin + 1e-6 or times[-1] > END - 1e-6):
            raise AmbiguousError
    found = []
    for number, t in enumerate(times):
        later = times[number + 1] if number + 1 < len(times) else max(segment.end, t + 1e-6)
        new = event.sign(segment.state(0.5 * (t + later)))
        if new != sign:
            found.append((t, (zeros | poles)[t]))
        sign = new
    return found


class Motion:
    """The motion, and its changes at jumps.

    Parameters
    ----------
    body
        Velocity and start of the body: x, y, angle, as coefficients of polynomials of t.
    rates, initial
        Rates of states, and their initial values.
    chain
        Points (time, position) of the driver; empty if there is none.
    period, output
        Period of the controller, and its output as a function of the state; 0 if there is none.
    """

    def __init__(self, rng: Random, kind: str):
        self.kind = kind
        draw = rng.uniform
        vx, vy, w = draw(0.5, 2.0), draw(8.0, 18.0), draw(-3.0, -0.5)
        x, y, angle = draw(-1.0, 1.0), draw(-1.0, 1.0), draw(-1.0, 1.0)
        self.body = {"b.x": (x, vx), "b.y": (y, vy, -0.5 * G), "b.vy": (vy, -G), "b.angle": (angle, w)}
        self.model: dict[str, Any] = {
            "name": "mechanism",
            "gravity": [0, -G],
            "bodies": {"b": {"mass": 1.0, "inertia": 0.5, "position": [x, y], "angle": angle, "velocity": [vx, vy],
                             "angular_velocity": w}},
        }  # fmt: skip
        self.states: dict[str, tuple[float, float]] = {}
        self.jumps: list[Time] = []
        if kind == "set":
            self.states = {"states.y": (draw(-0.5, 0.5), draw(0.5, 2.0)), "states.n": (0.0, 0.0)}
            self.model["states"] = {
                name.removeprefix("states."): {"rate": repr(rate), "initial": value}
                for name, (value, rate) in self.states.items()
            }
        elif kind == "impulse":
            self.jumps = sorted(draw(0.2, END - 0.2) for _ in range(rng.randint(1, 4)))
            if rng.random() < 0.3:
                self.jumps = sorted({round(t, 1) for t in self.jumps})
            times = [0.0, *self.jumps, END]
            self.chain = [(t, draw(-2.0, 2.0)) for t in times]
            table = {"table": [[*times], [p for _, p in self.chain]], "interpolation": "linear"}
            self.model["bodies"]["d"] = {"mass": 2.0, "inertia": 0.1, "position": [self.chain[0][1], 0.0]}
            self.model["joints"] = {
                "rail": {"type": "prismatic", "bodies": ["ground", "d"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
                "motor": {"type": "driver", "bodies": ["ground", "d"], "coordinate": "x", "motion": table},
            }
        elif kind == "sample":
            self.period = rng.choice([0.1, 0.25, draw(0.05, 0.7)])
            self.gain, self.turns = draw(-2.0, 2.0), draw(1.0, 9.0)
            # 5 is added because the body could be at rest otherwise
            output = f"{self.gain!r}*b.x + sin({self.turns!r}*t)"
            self.model["controllers"] = {"c": {"period": self.period, "outputs": {"u": output}}}
            count = math.ceil(END / self.period - 1e-9)
            self.jumps = [k * self.period for k in range(1, count)]
            self.pass_jump(0.0)

    def segment(self, begin: Time, end: Time) -> Segment:
        """Return the motion from a time on, without later jumps."""
        shifted = {}
        for name, (c, b, *a) in self.body.items():
            square = a[0] if a else 0.0
            shifted[name] = (c + b * begin + square * begin * begin, b + 2.0 * square * begin, square)
        shifted |= {name: (value, rate) for name, (value, rate) in self.states.items()}
        self.last = begin
        if self.kind == "impulse":
            number = sum(t <= begin for t in self.jumps)
            (t0, p0), (t1, p1) = self.chain[number : number + 2]
            v = (p1 - p0) / (t1 - t0)
            shifted |= {"d.x": (p0 + v * (begin - t0), v), "d.vx": (v,)}
        return Segment(begin, end, shifted)

    def pass_jump(self, t: Time) -> None:
        """Pass a sample of the controller."""
        if self.kind == "sample":
            x, vx = self.body["b.x"]
            held = self.gain * (x + vx * t) + math.sin(self.turns * t)
            self.states["controllers.c.u"] = held, 0.0

    def set(self, t: Time, events: Sequence[DrawnEvent]) -> None:
        """Go to a time and set states there."""
        self.states = {name: (value + rate * (t - self.last), rate) for name, (value, rate) in self.states.items()}
        before = self.segment(t, END).state(t)
        for event in events:
            for name, (_, value) in event.sets.items():
                self.states[f"states.{name}"] = value(before), self.states[f"states.{name}"][1]


def _level(rng: Random, motion: Motion, name: str) -> float:
    """Return a value that a quantity is likely to have during the run."""
    if name in ("states.y", "states.n"):
        return rng.uniform(-0.3, 1.3) if name == "states.y" else rng.randint(0, 4) + 0.5
    if name == "d.vx":
        return rng.uniform(-3.0, 3.0)
    t = rng.uniform(0.1, END - 0.1)
    if name == "controllers.c.u":
        return motion.gain * (motion.body["b.x"][0] + motion.body["b.x"][1] * t)
    if rng.random() < 0.3:
        t = round(t, 1)  # at the end of a fixed step
    return t if name == "t" else motion.segment(0.0, END).state(t)[name]


def draw_factor(rng: Random, motion: Motion, names: Sequence[str], *, alone: bool) -> Factor:
    """Return a factor of one of the quantities with the given names."""
    name = rng.choice(names)
    level = _level(rng, motion, name)
    is_constant = name in ("d.vx", "states.n", "controllers.c.u")
    form = "power" if is_constant else rng.choice(["power", "power", "pole", "square", "abs", "wave", "larger"])
    if form == "power":
        return power(
            name,
            level,
            1 if is_constant or name == "b.y" else rng.choice([1, 1, 1, 3, 3, 5, 9, 21] + [2] * (not alone)),
        )
    if form == "pole" and name != "b.y" and not alone:
        return power(name, level, rng.choice([-1, -1, -2, -3]))
    if form in ("square", "abs"):
        smallest = -2.0 if name == "b.y" else -5.0
        return dip(name, level, 10.0 ** rng.uniform(smallest, -0.5), form)
    linear = [one for one in names if one in ("t", "b.x", "b.angle", "states.y", "d.x")]
    if form == "larger" and len(linear) > 1:
        pair = rng.sample(linear, 2)
        return larger(pair, [_level(rng, motion, one) for one in pair], rng.choice(["max", "min"]))
    return wave(
        rng.choice(linear or ["t"]),
        rng.uniform(1.0, 40.0),
        rng.uniform(-3.0, 3.0),
        rng.choice([1, 1, 3] + [2] * (not alone)),
    )


def draw_case(number: int) -> Case:
    """Return the case with a number, the seed of its random numbers."""
    rng = Random(number)
    while True:
        try:
            return _draw(rng, number)
        except AmbiguousError:
            continue


def _draw(rng: Random, number: int) -> Case:
    kind = rng.choice(["free", "free", "set", "set", "impulse", "sample"])
    motion = Motion(rng, kind)
    adaptive = rng.random() < 0.5
    method = rng.choice(ADAPTIVE if adaptive else FIXED + WITHOUT_STATES * (kind == "free"))
    own = {"free": [], "set": ["states.y", "states.y", "states.n"], "impulse": ["d.x", "d.vx", "d.vx"],
           "sample": ["controllers.c.u"] * 3}[kind]  # fmt: skip
    names = ["t", "b.x", "b.y", "b.vy", "b.angle", *own]
    events = []
    for index in range(rng.randint(1, 4)):
        count = rng.choice([1, 1, 1, 2, 3])
        factors = [draw_factor(rng, motion, names, alone=count == 1) for _ in range(count)]
        direction = rng.choice(["any", "any", "rising", "falling"])
        events.append(DrawnEvent(f"e{index}", factors, direction, "stop" if rng.random() < 0.15 else "note"))
    if kind == "set":
        high, low = rng.uniform(0.6, 1.2), rng.uniform(-0.5, 0.5)
        reset = {"y": (repr(low), lambda state: low)}
        if rng.random() < 0.5:
            reset["n"] = ("states.n + 1", lambda state: state["states.n"] + 1.0)
        events.append(DrawnEvent("reset", [power("states.y", high, 1)], "rising", sets=reset))
        if rng.random() < 0.5:  # the expression of the event that sets, with the other sign or to a power
            events.append(
                DrawnEvent("same", [power("states.y", high, rng.choice([1, 3]))], rng.choice(["any", "falling"]))
            )
        if rng.random() < 0.5:  # a chain: it sets a state because the first event does
            chain = {"n": ("states.n + 1", lambda state: state["states.n"] + 1.0)}
            middle = rng.uniform(low, high)
            direction = rng.choice(["falling", "any", "rising"])
            events.append(DrawnEvent("chain", [power("states.y", middle, 1)], direction, sets=chain))
        rng.shuffle(events)
    finder = Finder(events, motion.jumps, motion)
    finder.find()
    times = sorted({t for t, *_ in finder.crossings})
    if any(END - t < 1e-6 for t in times) and finder.end == END:
        raise AmbiguousError
    spec: dict[str, Any] = {"model": motion.model, "events": {event.name: event.spec for event in events}}
    spec["time"] = {"end": END}
    if not adaptive:
        spec["time"]["step"] = rng.choice([0.02, 0.05, 0.1, 0.3, END])
    if kind == "impulse":
        spec["impacts"] = "allow"
    if isinstance(method, dict) and method["name"] in ("rattle", "lobatto-pair"):
        spec["formulation"] = "index-3"
    if method == {"name": "taylor"}:
        spec["formulation"] = "joint-coordinates"
    return Case(number, method, spec, events, finder.crossings, finder.end)
