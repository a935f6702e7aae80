"""`python -m tests.benchmarks.two_sides [--count 500]`: rows and values at instants with two sides.

Drawn hybrid automata, one instant each: events that set states (by time, by a state, by a position, several at once, in
chains), a bouncing ball, an input, a driver with an impulse, a controller, a load that jumps, stops and ends at a jump.
Every method runs them; rows lie at the instant. Expected values are closed forms. Printed are the wrong ones.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import mbdkit

TIGHT = {"adaptive": True, "rtol": 1e-10, "atol": 1e-12}
METHODS: tuple[dict[str, Any], ...] = (
    {"name": "rk4"}, {"name": "gauss", "stages": 3}, {"name": "radau-iia", "stages": 2},
    {"name": "dop853", **TIGHT}, {"name": "dopri5", **TIGHT}, {"name": "radau-iia", **TIGHT},
    {"name": "gauss", "stages": 3, **TIGHT}, {"name": "scipy-dop853", "rtol": 1e-10, "atol": 1e-12},
    {"name": "scipy-radau", "rtol": 1e-9, "atol": 1e-11},
)  # fmt: skip
BODY = {"mass": 1.0, "inertia": 1.0}
CLOSE = 1e-6
"""Deviations from the closed forms that count as right; values before and after differ by at least 0.05."""


@dataclass(frozen=True)
class Automaton:
    """A mechanism with one instant at `time` [s], and the values of quantities before and after it."""

    kind: str
    time: float
    sections: Mapping[str, Any]
    sides: Mapping[str, tuple[float, float]]
    event: str = ""
    """An event at the instant."""
    ends: bool = False
    """Whether the run ends at the instant."""
    parameter: str = ""
    """Key of a number with respect to which `slopes` are derivatives."""
    slopes: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def _model(**more: Any) -> dict[str, Any]:
    body = BODY | more.pop("body", {})
    return {"name": "mechanism", "gravity": [0, 0], "bodies": {"b": body}, **more}


def _force(value: Any) -> dict[str, Any]:
    return {"push": {"type": "force", "body": "b", "value": [value, 0]}}


def _state(rate: Any = 0, initial: float = 0.0) -> dict[str, Any]:
    return {"rate": str(rate), "initial": initial}


def by_time(c: float, r: np.random.Generator) -> Automaton:
    """An event at a given time sets two states, one of which is a force."""
    rate, factor, force = r.uniform(0.5, 2.0), r.uniform(-0.5, 0.5), r.uniform(0.5, 2.0)
    model = _model(forces=_force("states.g"), states={"y": _state(rate), "g": _state(0, force)})
    events = {"A": {"when": f"t - {c!r}", "set": {"y": f"{factor}*states.y", "g": "-states.g"}}}
    sides = {"states.y": (rate * c, factor * rate * c), "b.ax": (force, -force), "b.vx": (force * c, force * c)}
    return Automaton("event by time", c, {"model": model, "events": events}, sides, "A")


def by_state(c: float, r: np.random.Generator) -> Automaton:
    """A state reaches a level, and is set back."""
    rate, back = r.uniform(0.5, 2.0), r.uniform(0.3, 0.9)
    events = {"A": {"when": f"states.y - {rate * c!r}", "direction": "rising", "set": {"y": f"states.y - {back}"}}}
    sides = {"states.y": (rate * c, rate * c - back)}
    return Automaton("event by state", c, {"model": _model(states={"y": _state(rate)}), "events": events}, sides, "A")


def by_position(c: float, r: np.random.Generator) -> Automaton:
    """A body reaches a place, where a force is switched."""
    speed, force = r.uniform(0.5, 2.0), r.uniform(0.5, 2.0)
    place = speed * c + 0.5 * force * c * c
    model = _model(body={"velocity": [speed, 0]}, forces=_force("states.g"), states={"g": _state(0, force)})
    events = {"A": {"when": f"b.x - {place!r}", "direction": "rising", "set": {"g": "-2*states.g"}}}
    sides = {"b.ax": (force, -2 * force), "states.g": (force, -2 * force), "b.x": (place, place)}
    return Automaton("event by position", c, {"model": model, "events": events}, sides, "A")


def together(c: float, r: np.random.Generator) -> Automaton:
    """Two events at one instant set states from the values before."""
    a, b = r.uniform(0.5, 1.0), r.uniform(1.5, 2.0)
    model = _model(states={"a": _state(0, a), "b": _state(0, b)})
    events = {
        "A": {"when": f"t - {c!r}", "set": {"a": "states.b"}},
        "B": {"when": f"{c!r} - t", "set": {"b": "states.a"}},
    }
    return Automaton(
        "events at once", c, {"model": model, "events": events}, {"states.a": (a, b), "states.b": (b, a)}, "B"
    )


def chain(c: float, r: np.random.Generator) -> Automaton:
    """The state that an event sets lets another one set a third."""
    z = r.uniform(0.5, 2.0)
    model = _model(states={"z": _state(0, z), "n": _state(), "m": _state()})
    events = {
        "A": {"when": f"t - {c!r}", "direction": "rising", "set": {"z": "-states.z"}},
        "B": {"when": "states.z", "set": {"n": "states.n + 1"}},
        "C": {"when": "states.n - 0.5", "set": {"m": "states.m + states.n"}},
    }
    sides = {"states.z": (z, -z), "states.n": (0.0, 1.0), "states.m": (0.0, 1.0)}
    return Automaton("chain", c, {"model": model, "events": events}, sides, "A")


def bounce(c: float, r: np.random.Generator) -> Automaton:
    """A ball falls on the ground."""
    restitution, radius = r.uniform(0.2, 0.9), r.uniform(0.05, 0.2)
    model = _model(body={"position": [0, radius + 0.5 * 9.81 * c * c], "inertia": 0.01}) | {"gravity": [0, -9.81]}
    shapes = [{"line": {"point": [0, 0], "normal": [0, 1]}}, {"circle": {"radius": radius}}]
    model["contacts"] = {"c": {"bodies": ["ground", "b"], "restitution": restitution, "shapes": shapes}}
    events = {"A": {"when": "b.vy", "direction": "rising"}}
    sides = {"b.vy": (-9.81 * c, restitution * 9.81 * c), "b.y": (radius, radius), "b.ay": (-9.81, -9.81)}
    sections = {"model": model, "contact": {"treatment": "event-driven"}, "events": events}
    return Automaton("bounce", c, sections, sides, "A")


def input_change(c: float, r: np.random.Generator) -> Automaton:
    """An input is set."""
    u, w = r.uniform(0.5, 1.0), r.uniform(1.5, 2.0)
    model = _model(inputs={"u": {"initial": u}}, forces=_force("inputs.u"))
    sections = {"model": model, "inputs": {"u": {"table": [[c], [w]]}}}
    sides = {"b.ax": (u, w), "inputs.u": (u, w), "b.vx": (u * c, u * c)}
    return Automaton("input", c, sections, sides)


def driver(c: float, r: np.random.Generator) -> Automaton:
    """The velocity of a driver jumps, which needs an impulse."""
    w = r.uniform(0.5, 2.0)
    joints = {
        "p": {"type": "revolute", "bodies": ["ground", "b"], "at": [0, 0]},
        "d": {"type": "driver", "bodies": ["ground", "b"], "coordinate": "angle", "motion": f"{w}*abs(t - {c!r})"},
    }
    sections = {"model": _model(joints=joints, body={"angle": w * c}), "impacts": "allow"}
    return Automaton("driver", c, sections, {"b.angular_velocity": (-w, w), "b.angle": (0.0, 0.0)})


def controller(c: float, r: np.random.Generator) -> Automaton:
    """A controller is sampled."""
    gain = r.uniform(0.5, 2.0)
    model = _model(controllers={"k": {"period": c, "outputs": {"u": f"{gain} + t"}}}, forces=_force("controllers.k.u"))
    return Automaton("controller", c, {"model": model}, {"b.ax": (gain, gain + c), "b.vx": (gain * c, gain * c)})


def load(c: float, r: np.random.Generator) -> Automaton:
    """A load jumps."""
    size = r.uniform(0.5, 2.0)
    wave = f"atan2(sin(pi*t/{c!r}), cos(pi*t/{c!r}))"
    model = _model(forces=_force(f"{size}*{wave}"))
    at = size * math.pi
    v = 0.5 * at * c
    slopes = {"b.ax": (-at, at), "b.vx": (-v, -v)}
    sides = {"b.ax": (at, -at), "b.vx": (v, v)}
    return Automaton("load", c, {"model": model}, sides, parameter="model.bodies.b.mass", slopes=slopes)


def stop(c: float, r: np.random.Generator) -> Automaton:
    """The state that an event sets lets another one stop the run."""
    rate = r.uniform(0.5, 2.0)
    model = _model(states={"y": _state(rate)})
    events = {
        "A": {"when": f"t - {c!r}", "set": {"y": "-states.y"}},
        "S": {"when": "states.y", "direction": "falling", "action": "stop"},
    }
    return Automaton("stop", c, {"model": model, "events": events}, {"states.y": (rate * c, math.nan)}, "S", ends=True)


def stop_at_impact(c: float, r: np.random.Generator) -> Automaton:
    """The run stops where the ball hits the ground."""
    ball = bounce(c, r)
    events = {"A": {"when": "b.vy", "direction": "rising", "action": "stop"}}
    return Automaton(
        "stop at impact", c, {**ball.sections, "events": events}, {"b.vy": (-9.81 * c, math.nan)}, "A", ends=True
    )


KINDS: tuple[Callable[[float, np.random.Generator], Automaton], ...] = (
    by_time, by_state, by_position, together, chain, bounce, input_change, driver, controller, load, stop,
    stop_at_impact,
)  # fmt: skip


def spec_of(one: Automaton, method: Mapping[str, Any], r: np.random.Generator) -> dict[str, Any]:
    """Return the spec of an automaton for a method, with rows at the instant."""
    is_fixed = not method.get("adaptive") and not method["name"].startswith("scipy")
    parts = int(r.integers(2, 6))
    interval, time = one.time / parts, {"end": one.time * (1 + 1 / parts)}
    output: dict[str, Any] = {"interval": interval}
    if is_fixed:
        finer = int(r.integers(2, 5))
        time["step"] = interval / finer
        output = {"every": finer} if method["name"] == "rk4" or r.random() < 0.5 else output
    elif r.random() < 0.2:
        output = {"every": 1}
    whens = {"c": repr(one.time)} | ({"e": f"events.{one.event}.time"} if one.event else {})
    measures = {
        f"{side}{when}{number}": {"value": f"{side}({quantity}, {text})", "unit": "1"}
        if quantity.startswith(("states", "inputs"))
        else f"{side}({quantity}, {text})"
        for number, quantity in enumerate(one.sides)
        for when, text in whens.items()
        for side in ("at", "after")
    }
    return {
        "mbdkit": 1,
        "integrator": dict(method),
        "time": time,
        "output": output,
        "measures": measures,
        **one.sections,
    }


def row_of(run: mbdkit.Run, quantity: str, k: int) -> float:
    """Return a quantity in row `k`."""
    name, attribute = quantity.split(".")
    if name in ("states", "inputs"):
        return float(getattr(run, name)[attribute].value[k])
    history = run.bodies[name]
    scalar = {"angle": "angle", "angular_velocity": "angular_velocity"}.get(attribute)
    if scalar:
        return float(getattr(history, scalar)[k])
    vector = {1: history.position, 2: history.velocity}
    which = history.acceleration if attribute[0] == "a" else vector[len(attribute)]
    return float(which[k, "xy".index(attribute[-1])])


def faults(kind: int, method: int, seed: int) -> Iterator[str]:
    """Yield what is wrong in the run of a drawn automaton."""
    r = np.random.default_rng([kind, method, seed])
    c = round(float(r.uniform(0.2, 1.9)), int(r.integers(1, 4)))
    one, chosen = KINDS[kind](c, r), METHODS[method]
    spec = spec_of(one, chosen, r)
    what = f"{one.kind}, {chosen['name']}{' adaptive' if chosen.get('adaptive') else ''}, c = {c}, {spec['output']}"
    run = mbdkit.run(spec)
    if run.status != "complete":
        yield f"{what}: {run.status_reason}"
        return
    row = int(np.argmin(np.abs(run.time - c)))
    if "interval" in spec["output"] and abs(run.time[row] - c) > 1e-11:
        yield f"{what}: no row at the instant, but at {run.time[row]!r}"
    has_row = abs(run.time[row] - c) < 1e-11
    if one.ends:
        row = len(run.time) - 1
        if not has_row or abs(run.time[-1] - c) > 1e-11:
            yield f"{what}: the run ends at {run.time[-1]!r}"
    for number, (quantity, sides) in enumerate(one.sides.items()):
        values = {"row": row_of(run, quantity, row)} if has_row else {}
        values |= {name: float(run.measures[name]) for name in run.measures if name.endswith(str(number))}
        for name, value in values.items():
            wanted = sides[name.startswith("after")]
            if not (abs(value - wanted) <= CLOSE or (math.isnan(value) and math.isnan(wanted))):
                yield f"{what}: {name} of {quantity} is {value:.9g}, not {wanted:.9g}"
    if seed % 2 == 0 and not one.ends and one.kind != "bounce":  # rounding decides whether an impact is before `c`
        yield from read_faults(one, spec, what)
    if one.parameter and "scipy" not in chosen["name"]:
        gradient = mbdkit.gradient(spec | {"output": {"every": 1}}, [*spec["measures"]], [one.parameter], check=False)
        for number, (quantity, slopes) in enumerate(one.slopes.items()):
            for side, wanted in zip(("at", "after"), slopes, strict=True):
                value = gradient[f"{side}c{number}", one.parameter]
                if not abs(value - wanted) <= CLOSE:
                    yield f"{what}: derivative of {side} of {quantity} is {value:.9g}, not {wanted:.9g}"


def read_faults(one: Automaton, spec: Mapping[str, Any], what: str) -> Iterator[str]:
    """Yield what a program reads at the instant that is not the value before it."""
    with mbdkit.open({name: value for name, value in spec.items() if name != "measures"}) as simulation:
        simulation.advance_to(one.time)
        values = simulation.read([*one.sides])
    for quantity, value, (wanted, _) in zip(one.sides, values, one.sides.values(), strict=True):
        if not abs(value - wanted) <= CLOSE:
            yield f"{what}: a program reads {value:.9g} for {quantity}, not {wanted:.9g}"


def drawn(count: int, first: int = 0) -> Iterator[list[str]]:
    """Yield the faults of each of `count` automata, over all kinds and methods."""
    pairs = [(kind, method) for method in range(len(METHODS)) for kind in range(len(KINDS))]
    for number in range(first, first + count):
        yield [*faults(*pairs[number % len(pairs)], number // len(pairs))]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="number of the first automaton")
    given = parser.parse_args()
    wrong = 0
    for number, some in enumerate(drawn(given.count, given.first), start=1):
        wrong += bool(some)
        print(*some, sep="\n", end="\n" if some else "", flush=True)
        print(f"\r{number} of {given.count}", end="", file=sys.stderr, flush=True)
    print(f"{given.count} automata: {wrong} with a wrong value")
