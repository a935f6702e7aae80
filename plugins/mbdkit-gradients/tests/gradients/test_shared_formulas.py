"""Differentiated runs, and those of their checks, have the numbers of runs, and measures share their states."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.measured_quantities import ATTRIBUTES
from mbdkit.spec import RunSpec, load_spec
from mbdkit_gradients.differentiated_states import StateEvaluator, require_derivative

FUNCTIONS = (
    "max(sin(rod1.angle), cos(rod2.angle)) - min(0.3, sin(rod1.angle))",
    "sqrt(rod1.angle**2 + 1) + exp(-abs(rod2.angle)) + log(2 + tanh(rod1.angle))",
    "atan2(rod1.vx, 2 + rod1.vy) + atan(rod2.angle) + asin(sin(rod1.angle)/2) + acos(cos(rod2.angle)/2)",
    "(2 + cos(rod1.angle))**(1/3) / (3 + tan(rod1.angle/4)) - rod2.angle**3",
)
"""Expressions over time that use every function."""


def spec(integrator: dict[str, Any], formulation: str, **sections: Any) -> RunSpec:
    """Return the spec of two rods with a motor, a damped spring, a load and a marker."""
    m = mbdkit.Mechanism()
    m.body("rod1", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("rod2", mass=2.0, inertia=0.2, position=(1.5, 0.0))
    m.revolute("A", m.ground, "rod1", at=(0, 0))
    m.revolute("B", "rod1", "rod2", at=(1, 0))
    m.driver("motor", m.ground, "rod1", coordinate="angle", motion="0.5*sin(3*t)")
    m.spring_damper("spring", m.ground, "rod2", points=((1.0, 1.0), (0.0, 0.0)), stiffness=50.0, damping=2.0)
    m.force("wind", "rod2", value=(1.0, 0.5))
    m.marker("tip", "rod2", at=(2, 0))
    given = {"integrator": integrator, "formulation": formulation, "time": {"end": 0.3, "step": 0.02}} | sections
    return load_spec(m, (), **given)


def expressions(of: RunSpec) -> dict[str, str]:
    """Return the final value and the mean of all quantities that have derivatives, and of `FUNCTIONS`."""
    mechanism = of.mechanism()
    names = {
        "bodies": mechanism.bodies, "joints": mechanism.joints, "forces": mechanism.forces,
        "markers": mechanism.markers, "energy": [""],
    }  # fmt: skip
    found = []
    for kind, owners in names.items():
        for owner in owners:
            for attribute in ATTRIBUTES[kind]:
                text = ".".join(filter(None, (kind, owner, attribute)))
                try:
                    one = MeasureExpression.parse(f"final(abs({text}))", of)
                    require_derivative(one.quantities[0])
                except mbdkit.SpecError:
                    continue
                found.append(f"abs({text})")
    texts = [f"{name}({text})" for name in ("final", "mean") for text in (*found, *FUNCTIONS)]
    return {f"m{place}": text for place, text in enumerate(texts)}


METHODS = [({"name": "rk4"}, "index-1"), ({"name": "radau-iia", "stages": 2}, "ggl")]


@pytest.mark.parametrize(("integrator", "formulation"), METHODS, ids=["rk4", "radau-iia"])
def test_a_differentiated_run_has_the_numbers_of_the_run(integrator: dict[str, Any], formulation: str) -> None:
    measures = expressions(spec(integrator, formulation))
    assert len(measures) > 150
    made = mbdkit.run(spec(integrator, formulation, measures=measures))
    found = mbdkit.gradient(made.spec, measures, "model.bodies.rod2.mass", check=False)
    for name, value in zip(found.measures, found.value, strict=True):
        assert value == pytest.approx(made.measures[name], rel=1e-10, abs=1e-12), measures[name]


KINDS_OF_MEASURES = {
    "at": "at(bodies.rod{rod}.angle, {share!r})", "integral": "integral((bodies.rod{rod}.angle + {share!r})**2)",
    "integral of abs": "integral(abs(bodies.rod{rod}.angle + 0.3 + 0.001*{share!r}))",
    "max": "max(bodies.rod{rod}.angle*(1 + {share!r}))", "final": "final(bodies.rod{rod}.angle + {share!r})",
}  # fmt: skip
PARAMETERS = ["model.lengths.0", "model.lengths.1", "model.masses.0", "model.masses.1"]


def of_three_rods(end: float = 1.2) -> dict[str, Any]:
    model = {"name": "n-pendulum", "n": 3, "angles": [0.3, 0.1, -0.2], "lengths": [1.0] * 3, "masses": [1.0] * 3}
    return {
        "mbdkit": 1, "model": model, "integrator": {"name": "gauss", "stages": 3}, "time": {"end": end, "step": 0.005},
    }  # fmt: skip


def measures(kind: str, count: int, end: float = 1.2) -> list[str]:
    shares = np.linspace(0.0, end, count + 2)[1:-1].tolist()
    return [KINDS_OF_MEASURES[kind].format(rod=1 + k % 3, share=share) for k, share in enumerate(shares)]


@pytest.mark.parametrize(("kind", "cost"), [("at", len), ("integral of abs", sum)])
def test_many_measures_share_their_states(
    kind: str, cost: Callable[[list[int]], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fewer evaluations, or fewer states, than in single gradients, which have the same bits."""
    calls: list[int] = []
    evaluate = StateEvaluator.states

    def counted(self: StateEvaluator, time: np.ndarray, *arguments: Any, **more: Any) -> Any:
        calls.append(len(time))
        return evaluate(self, time, *arguments, **more)

    monkeypatch.setattr(StateEvaluator, "states", counted)
    wanted = measures(kind, 6, end=0.3)
    found = mbdkit.gradient(of_three_rods(end=0.3), wanted, PARAMETERS, check=False)
    together, calls[:] = list(calls), []
    separate = [mbdkit.gradient(of_three_rods(end=0.3), text, PARAMETERS, check=False) for text in wanted]
    assert cost(together) < 0.4 * cost(calls)
    np.testing.assert_array_equal(found.value, [one.value[0] for one in separate])
    np.testing.assert_array_equal(found.jacobian, [one.jacobian[0] for one in separate])
