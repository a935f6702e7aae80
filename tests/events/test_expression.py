"""Expressions over a run: what they may name, what they are worth, and what is refused."""

from __future__ import annotations

import math

import pytest

import mbdkit
from mbdkit.events.event_expression import RunExpression
from mbdkit.quantities.quantity import Quantity


def mechanism() -> mbdkit.Mechanism:
    """Return two rods, the outer of which shares its name with a joint, and a point mass."""
    m = mbdkit.Mechanism()
    inner = m.body("inner", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    outer = m.body("B", mass=1.0, inertia=0.1, position=(1.5, 0.0))
    weight = m.body("weight 1", mass=1.0, position=(2.0, 0.0))
    m.revolute("A", m.ground, inner, at=(0.0, 0.0))
    m.revolute("B", inner, outer, at=(1.0, 0.0))
    m.revolute("left-hand", outer, weight, at=(2.0, 0.0))
    m.driver("lift", inner, weight, coordinate="y", motion="0.1*t")
    m.spring_damper("spring", inner, weight, from_=(0.0, 1.0), to=(2.0, 0.0), stiffness=1.0)
    m.marker("tip", outer, at=(2.0, 0.0))
    m.marker("heel-a", inner)
    return m


def value(text: str, **values: float) -> float:
    """Return what an expression is worth; keywords are attributes of the body `inner`."""
    expression = RunExpression.parse(text, mechanism())
    places = {quantity: place for place, quantity in enumerate(expression.quantities, start=1)}
    row = [values.get("t", 0.0), *(values[quantity.attribute] for quantity in expression.quantities)]
    return expression.function(places)(row)


def test_operators_and_functions_mean_what_they_mean_in_motions() -> None:
    assert value("2*inner.x - 3", x=5.0) == 7.0
    assert value("-inner.x**2 + t/4", x=3.0, t=2.0) == -8.5
    assert value("atan2(inner.y, inner.x) - min(1, inner.x, t)", x=-1.0, y=0.0, t=3.0) == math.pi + 1.0
    assert value("inner.x**0.5 - sqrt(2)", x=2.0) == 0.0
    assert value("sin(pi*inner.x) + abs(t) - exp(0)", x=0.5, t=-2.0) == 2.0


def test_what_has_no_value_is_nan() -> None:
    assert math.isnan(value("sqrt(inner.x) - 1", x=-1.0))
    assert math.isnan(value("1/inner.x", x=0.0))
    assert math.isnan(value("exp(inner.x) - 1", x=1e6))
    assert math.isnan(value("inner.x**0.5 - 1", x=-1.0))


@pytest.mark.parametrize(
    ("text", "quantity"),
    [
        ("A.torque", Quantity("joints", "A", "torque")),
        ("inner.angular_velocity", Quantity("bodies", "inner", "angular_velocity")),
        ("bodies.B.angle", Quantity("bodies", "B", "angle")),
        ("joints.B.angle", Quantity("joints", "B", "angle")),
        ("B.vx", Quantity("bodies", "B", "vx")),
        ("B.force_x", Quantity("joints", "B", "force_x")),
        ('bodies["weight 1"].x', Quantity("bodies", "weight 1", "x")),
        ("joints['left-hand'].force_y", Quantity("joints", "left-hand", "force_y")),
        ("energy.total", Quantity("energy", "", "total")),
        ("forces.spring.value", Quantity("forces", "spring", "value")),
        ("markers.tip.vy", Quantity("markers", "tip", "vy")),
        ("markers['heel-a'].x", Quantity("markers", "heel-a", "x")),
        ("lift.driver_power", Quantity("joints", "lift", "driver_power")),
        ("joints.A.force_first_x", Quantity("joints", "A", "force_first_x")),
        ("lift.angle", Quantity("joints", "lift", "angle")),
    ],
)
def test_names_of_a_run(text: str, quantity: Quantity) -> None:
    assert RunExpression.parse(text, mechanism()).quantities == (quantity,)
