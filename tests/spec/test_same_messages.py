"""The same mistake in a spec, in `Mechanism.from_spec` and in a call of the builder gives the same message."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mbdkit.base.errors import SpecError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec

ENDS = {"bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]}
POINTS = ENDS["points"]
FORCE = {"type": "force", "body": "rod", "value": [0, 1]}


Call = Callable[[Mechanism], Any]


def one_sided(**options: Any) -> tuple[str, Any, Call]:
    """Return an element with the law `one-sided` and these options, in a spec and as a call."""
    element = {"type": "law", "law": "one-sided", "pathway": {"type": "two-points", **ENDS}, **options}
    return "forces.p", element, lambda m: m.law("p", "ground", "rod", law="one-sided", points=POINTS, **options)


#: What is wrong: the key below `model`, the value in the spec, and the call.
WRONG: dict[str, tuple[str, Any, Call]] = {
    "two mistakes": ("bodies.c", {"mass": -1, "inertia": True}, lambda m: m.body("c", mass=-1, inertia=True)),
    "quotes": ("bodies.c", {"mass": "1"}, lambda m: m.body("c", mass="1")),
    "NaN": ("bodies.c", {"mass": np.float64("nan")}, lambda m: m.body("c", mass=np.float64("nan"))),
    "gravity": ("gravity", [0, math.inf], lambda _: Mechanism(gravity=[0, math.inf])),
    "body by number": (
        "joints.A",
        {"type": "revolute", "bodies": ["ground", 0], "points": POINTS},
        lambda m: m.revolute("A", "ground", 0, points=POINTS),
    ),
    "missing": ("bodies.c", {}, lambda m: m.body("c")),
    "unknown": ("bodies.c", {"mas": 1}, lambda m: m.body("c", mas=1)),
    "type": ("joints.A", {"type": "revolut", **ENDS}, lambda m: m.add("joints", "A", type="revolut", **ENDS)),
    "coordinate": (
        "joints.A",
        {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angel", "motion": 1},
        lambda m: m.driver("A", "ground", "rod", coordinate="angel", motion=1),
    ),
    "stiffness": (
        "forces.s",
        {"type": "spring-damper", **ENDS, "stiffness": -1},
        lambda m: m.spring_damper("s", "ground", "rod", points=POINTS, stiffness=-1),
    ),
    "frame": ("forces.f", {**FORCE, "frame": "locl"}, lambda m: m.force("f", "rod", value=[0, 1], frame="locl")),
    "tolerance": ("assembly", {"tolerance": 0}, lambda m: m.hold(tolerance=0)),
    "option": one_sided(stifness=1, acts="pull"),
    "option of another law": one_sided(stiffness=1, acts="tension", table=[]),
    "option missing": one_sided(stiffness=1),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_spec_and_the_builder_give_the_same_message(case: str) -> None:
    key, value, call = WRONG[case]
    model: dict[str, Any] = {"name": "mechanism", "bodies": {"rod": {"mass": 1, "inertia": 1}}}
    section, _, name = key.partition(".")
    model[section] = {**model.get(section, {}), name: value} if name else value
    built = Mechanism()
    built.body("rod", mass=1, inertia=1)
    spec = {"mbdkit": 1, "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 0.1}, "model": model}
    messages = []
    for attempt in (lambda: load_spec(spec), lambda: Mechanism.from_spec(model), lambda: call(built)):
        with pytest.raises(SpecError) as caught:
            attempt()
        messages.append(str(caught.value))
    assert messages[0].startswith(f"model.{key}")
    assert messages == messages[:1] * 3
