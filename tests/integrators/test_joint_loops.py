"""Joint coordinates with cut joints imposed on velocities, positions, or both: motion, orders, drift, refusals."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from tests.engine.random_mechanisms import ladder
from tests.integrators.pendulums_on_joints import KINDS
from tests.margins import assert_within

from .running import EPS, assert_same_end

LOOPS = {"index-2": ("velocity",), "index-3": ("position",), "ggl": ("position", "velocity")}
"""Levels at which cut joints hold."""

RADAU: dict[str, Any] = {"name": "radau-iia"}
CLOSED = {kind: KINDS[kind][:2] for kind in ("rolling", "frame", "loop")} | {"ladder": (ladder, None)}


def joint(loops: str) -> dict[str, str]:
    """Return the formulation."""
    return {"name": "joint-coordinates", "loops": loops}


def four_bar(stiffness: float = 30.0, damping: float = 1.0, free_length: float = 0.0) -> Mechanism:
    """Return a four-bar linkage with a spring on its coupler and a torque of 6 cos(3 t) on its crank."""
    m = Mechanism()
    ends = {"A": (0.0, 0.0), "B": (0.4, 0.6), "C": (1.9, 1.5), "D": (2.2, 0.3)}
    for name, first, second, mass in (("crank", "A", "B", 1.0), ("coupler", "B", "C", 2.0), ("rocker", "D", "C", 1.5)):
        p, q = np.array(ends[first]), np.array(ends[second])
        length, angle = float(np.hypot(*(q - p))), float(np.arctan2(*(q - p)[::-1]))
        m.body(name, mass=mass, inertia=mass * length**2 / 12, position=(p + q) / 2, angle=angle)
    for name, bodies in {"A": ("ground", "crank"), "D": ("ground", "rocker"), "B": ("crank", "coupler")}.items():
        m.revolute(name, *bodies, at=ends[name])
    m.revolute("C", "coupler", "rocker", at=ends["C"])
    m.spring_damper(
        "spring", "ground", "coupler", points=((0.5, 2.0), (0.2, 0.1)), stiffness=stiffness, damping=damping,
        free_length=free_length,
    )  # fmt: skip
    m.torque("drive", "crank", value="6*cos(3*t)")
    return m


@pytest.mark.parametrize("loops", LOOPS)
@pytest.mark.parametrize("kind", CLOSED)
def test_motion_and_reactions_are_those_in_the_coordinates_of_the_bodies(kind: str, loops: str) -> None:
    # expected: the same formulation in absolute coordinates, with the same method and steps, at which both converge
    make, cut = CLOSED[kind]
    steps: dict[str, Any] = {"integrator": {**RADAU, "stages": 5}, "time": {"end": 0.05, "step": 0.0025}}
    ours, theirs = (
        mbdkit.run(make(np.random.default_rng(1)), formulation=one, **steps) for one in (joint(loops), loops)
    )
    size = assert_same_end(ours, theirs)
    for name, mine in ours.joints.items():
        in_tree = cut is not None and name not in cut
        if in_tree or "position" in LOOPS[loops]:
            assert np.max(mine.misalignment[1:]) <= (4 if in_tree else 40) * EPS * size, name
        if in_tree or "velocity" in LOOPS[loops]:
            assert_within(mine.velocity_misalignment[1:], 1e-13 * size, name)


def state(run: mbdkit.Run) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions and angles of the bodies at the end of a run, and their rates."""
    bodies = run.bodies.values()
    return (
        np.array([[*x.position[-1], x.angle[-1]] for x in bodies]),
        np.array([[*x.velocity[-1], x.angular_velocity[-1]] for x in bodies]),
    )


@pytest.mark.parametrize(("loops", "orders"), [("index-2", (5, 5)), ("index-3", (5, 3)), ("ggl", (5, 5))])
def test_three_stages_keep_the_orders_of_the_formulation(loops: str, orders: tuple[int, int]) -> None:
    # orders: Hairer, Lubich and Roche (1989); expected motion: DOP853 at 1e-12 in absolute coordinates
    exact = {"integrator": {"name": "dop853", "adaptive": True, "rtol": 1e-12}, "stabilization": "projection"}
    expected = state(mbdkit.run(four_bar(), **exact, time={"end": 1.0}, output={"interval": 1.0}))
    errors = []
    for n in (80, 160):
        run = mbdkit.run(four_bar(), formulation=joint(loops), integrator=RADAU, time={"end": 1.0, "step": 1.0 / n})
        errors.append([np.max(np.abs(a - b)) for a, b in zip(state(run), expected, strict=True)])
    assert np.log2(np.divide(*errors)) == pytest.approx(orders, abs=0.3)


@pytest.mark.parametrize("loops", LOOPS)
def test_a_stiff_spring_takes_about_as_many_iterations_as_in_absolute_coordinates(loops: str) -> None:
    # 1e6 N/m and 1e4 N s/m, from a state in which the spring is 0.4 mm away from its free length
    stiff = four_bar(1e6, 1e4, 1.0825)
    spent, angles = [], []
    for formulation in (joint(loops), loops):
        run = mbdkit.run(stiff, formulation=formulation, integrator=RADAU, time={"end": 1.0, "step": 0.05})
        spent.append(run.check().stats["newton_iterations"])
        angles.append(run.bodies["rocker"].angle[-1])
    assert spent[0] <= 1.25 * spent[1]
    assert angles[0] == pytest.approx(angles[1], abs=1e-7)


@pytest.mark.parametrize("loops", LOOPS)
def test_adaptive_steps_dense_rows_and_events_keep_the_tree_closed(loops: str) -> None:
    # expected: DOP853 at 1e-12 in absolute coordinates
    settings: dict[str, Any] = {
        "time": {"end": 1.0}, "output": {"interval": 0.013}, "measures": {"square": "integral(bodies.rocker.angle**2)"},
        "events": {"turned": {"when": "bodies.crank.angle - 1.2"}},
    }  # fmt: skip
    run = mbdkit.run(
        four_bar(), formulation=joint(loops), integrator={**RADAU, "adaptive": True, "rtol": 1e-8}, **settings
    )
    exact = mbdkit.run(four_bar(), integrator={"name": "dop853", "adaptive": True, "rtol": 1e-12}, **settings)
    for name in "ABD":
        assert np.max(run.joints[name].misalignment) <= 8 * EPS * 2.0, name
        assert_within(run.joints[name].velocity_misalignment, 1e-13, name)
    angles, expected = run.bodies["rocker"].angle, exact.bodies["rocker"].angle
    np.testing.assert_allclose(angles, expected, atol=1e-6)
    assert run.measures["square"] == pytest.approx(exact.measures["square"], abs=1e-6)
    found = run.events.of_name("turned").time
    assert len(found) > 0
    np.testing.assert_allclose(found, exact.events.of_name("turned").time, atol=1e-6)


def sections(**others: Any) -> dict[str, Any]:
    """Return a spec of a double pendulum, which has no loops."""
    model, time = {"name": "double-pendulum"}, {"end": 0.1, "step": 0.01}
    return {"mbdkit": 1, "model": model, "integrator": RADAU, "time": time, "formulation": joint("ggl")} | others


def test_the_formulation_is_stored_and_named() -> None:
    spec = load_spec(sections())
    assert json.loads(spec.canonical_json())["formulation"] == joint("ggl")
    assert load_spec(json.loads(spec.canonical_json())).run_id() == spec.run_id()
    plain = load_spec(sections(formulation="joint-coordinates")).run_id()
    assert load_spec(sections(formulation=joint("index-1"))).run_id() == plain
    run = mbdkit.run(spec)
    assert "joint-coordinates (loops: ggl)" in run.summary()
    with pytest.raises(SpecError, match="with joint-coordinates, only steps of explicit Runge-Kutta methods have"):
        mbdkit.gradient(spec, "final(bodies.rod2.angle)", "model.gravity.1")
