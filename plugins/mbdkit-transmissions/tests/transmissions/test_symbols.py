"""Joints that are functions of the pose in SymPy, against the compiled engine."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp

from mbdkit import EquationsOfMotion, Mechanism, SpecError


def pair(**second: object) -> Mechanism:
    """Return a mechanism of two bodies without joints."""
    m = Mechanism()
    m.body("a", mass=1.0, inertia=0.1, position=(0.1, 0.2), angle=0.3)
    m.body("b", mass=2.0, inertia=0.3, **({"position": (0.5, 0.25), "angle": 0.7} | second))  # type: ignore[arg-type]
    return m


def geared() -> Mechanism:
    """Return a gear whose bodies turn on a carrier, and a gear in a ring of the ground."""
    m = pair(position=(0.34, 0.38))
    m.gear("G", "a", "b", radii=(0.1, 0.2), pressure_angle=0.0)
    m.gear("ring", m.ground, "b", radii=(0.6, 0.6 - math.hypot(0.34, 0.38)), internal=True, pressure_angle=0.0)
    return m


def rolling() -> Mechanism:
    """Return wheels on a line and on a circle."""
    m = pair()
    m.rolling("line", m.ground, "a", radius=0.2)
    m.rolling("circle", "a", "b", radius=0.3, on_radius=math.hypot(0.4, 0.05) - 0.3)
    return m


def belted() -> Mechanism:
    """Return a rack, and belts over different and over equal pulleys."""
    m = pair()
    m.rack("rack", "a", m.ground, radius=0.2)
    m.belt("open", "a", "b", radii=(0.05, 0.1))
    m.belt("equal", "a", "b", radii=(0.05, 0.05))
    return m


def curved() -> Mechanism:
    """Return a slot given by an expression, and a coupling of all coordinates."""
    m = pair()
    m.slot("graph", "a", "b", curve={"y": "0.3*x**2 - 0.1"}, point=(0.02, 0.03))
    m.coupling("K", "a", "b", equation="sin(angle)*x - 2*first**3 + 0.25*pi*t**2 + exp(y*second) - 1")
    return m


def tabulated() -> Mechanism:
    """Return a slot given by a table."""
    m = pair()
    m.slot("table", "a", "b", curve={"y": {"table": [[0.0, 0.2, 0.4, 0.6], [0.0, 0.1, 0.05, 0.2]]}})
    return m


def periodic() -> Mechanism:
    """Return a cam given by a table."""
    m = pair()
    m.cam("C", "a", "b", profile={"table": [[0, 2, 4, 2 * math.pi], [0.5, 0.6, 0.55, 0.5]], "ends": "periodic"})
    return m


@pytest.mark.parametrize("numbers", [True, False])
@pytest.mark.parametrize(
    "model", [geared, rolling, belted, curved, tabulated, pytest.param(periodic, marks=pytest.mark.slow)]
)
def test_symbols_and_engine_give_the_same_numbers(model: Callable[[], Mechanism], numbers: bool) -> None:
    m = model()
    system, equations = m.to_sympy(numbers=numbers), EquationsOfMotion.of(m)
    generator = np.random.default_rng(4)
    q = equations.q0 + 0.02 * generator.standard_normal(equations.n)
    v = generator.standard_normal(equations.n)
    wanted = system.evaluate(0.7, q, v)
    for value, name in (
        (equations.constraints(0.7, q), "constraints"),
        (equations.constraint_jacobian(0.7, q).toarray(), "constraint_jacobian"),
        (equations.gamma(0.7, q, v), "gamma"),
    ):
        expected = wanted[name]
        np.testing.assert_allclose(value, expected, rtol=0, atol=1e-12 * np.max(np.abs(expected)), err_msg=name)


def test_a_coupling_shows_its_equation() -> None:
    m = pair()
    m.coupling("K", "a", "b", equation="angle - 2*first**2 + pi*t/3")
    system = m.to_sympy()
    a, b = (sp.Symbol(f"theta_{name}", real=True) for name in "ab")
    assert system.constraints[0] == b - a - 2 * a**2 + sp.pi * system.t / 3


def test_parameters_of_gears_are_symbols() -> None:
    m = pair(position=(0.34, 0.38))
    m.gear("G", "a", "b", radii=(0.1, 0.2), pressure_angle=0.0)
    values = {str(symbol): value for symbol, value in m.to_sympy(numbers=False).parameters.items()}
    assert values["radius_G"] == 0.2
    assert values["distance_G"] == pytest.approx(0.3, rel=1e-15)


def test_the_root_of_an_equation_has_no_symbols() -> None:
    m = pair()
    m.cam("C", "a", "b", profile=0.3, follower={"roller": 0.1})
    with pytest.raises(SpecError, match="joint 'C' has no symbolic form, because its constraint is the root") as error:
        m.to_sympy()
    assert error.value.key == "model.joints.C"


def test_a_radial_force_is_refused_because_it_follows_the_reaction() -> None:
    m = pair(position=(0.34, 0.38))
    m.gear("G", "a", "b", radii=(0.1, 0.2))
    with pytest.raises(SpecError, match="the radial force of the teeth has no symbolic form; set it to 0") as error:
        m.to_sympy()
    assert error.value.key == "model.joints.G.pressure_angle"
