"""What force laws do to a motion: against analytic motions, and against each other written in other ways."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import mbdkit
from mbdkit import Mechanism, Run
from tests.margins import assert_within

GAUSS = {"name": "gauss", "stages": 3}
RK4 = {"name": "rk4"}


def run(m: Mechanism, end: float, step: float, integrator: Any = None) -> Run:
    found = mbdkit.run(m, integrator=integrator or GAUSS, time={"end": end, "step": step})
    found.check()
    return found


def mass_on_a_line(position: float, velocity: float, **body: Any) -> Mechanism:
    """Return a point mass of 1 kg that moves along the x axis, without gravity."""
    m = Mechanism(gravity=(0, 0))
    m.body("mass", mass=1.0, position=(position, 0.0), velocity=(velocity, 0.0), **body)
    return m


def swinging(along: str, law: str, **options: Any) -> Mechanism:
    """Return a double pendulum with a law between its rods, and one from the ground."""
    m = Mechanism()
    m.body("upper", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("lower", mass=0.7, inertia=0.08, position=(1.4, 0.2), angle=0.4)
    m.revolute("A", m.ground, "upper", points=((0, 0), (-0.5, 0)))
    m.revolute("B", "upper", "lower", points=((0.5, 0), (-0.45, 0)))
    places: dict[str, Any] = {}
    if along == "line":
        places = {"points": ((0.1, 0.3), (0.3, 0.1))}
    elif along != "angle":
        places = {"points": ((0.0, 0.0), (0.3, 0.1))}
    if law == "built-in":
        add = m.spring_damper if along == "line" else m.torsion_spring
        free = "free_length" if along == "line" else "free_angle"
        add("s", "upper", "lower", **places, **{free if key == "free" else key: x for key, x in options.items()})
    else:
        m.law("s", "upper", "lower", law=law, along=along, **places, **options)
    return m


@pytest.mark.parametrize("integrator", [RK4, GAUSS], ids=["rk4", "gauss"])
@pytest.mark.parametrize("along", ["line", "angle"])
@pytest.mark.parametrize("law", ["linear-sympy", "linear-numba"])
def test_a_linear_law_moves_like_the_built_in_spring(law: str, along: str, integrator: Any) -> None:
    # expected: the same numbers but for round-off, which this motion enlarges little over a second
    options = {"stiffness": 40.0, "damping": 0.8, "free": 0.3}
    expected = run(swinging(along, "built-in", **options), 1.0, 0.01, integrator)
    found = run(swinging(along, law, **options), 1.0, 0.01, integrator)
    np.testing.assert_allclose(found["lower"].position, expected["lower"].position, rtol=0, atol=1e-13)
    for name in ("potential", "dissipated", "work", "balance"):
        np.testing.assert_allclose(getattr(found.energy, name), getattr(expected.energy, name), rtol=0, atol=1e-12)


@pytest.mark.parametrize("along", ["line", "angle", "x", "y"])
@pytest.mark.parametrize(
    ("name", "options"),
    [("duffing", {"stiffness": 20.0, "cubic": 50.0, "damping": 0.5}), ("pump", {})],
    ids=["duffing", "pump"],
)
def test_a_law_in_sympy_moves_like_the_same_law_as_a_function(name: str, options: Any, along: str) -> None:
    runs = [run(swinging(along, f"{name}-{kind}", **options), 1.0, 0.02) for kind in ("sympy", "numba")]
    np.testing.assert_allclose(runs[0]["lower"].position, runs[1]["lower"].position, rtol=0, atol=1e-12)
    np.testing.assert_allclose(runs[0].energy.dissipated, runs[1].energy.dissipated, rtol=0, atol=1e-12)
    np.testing.assert_allclose(runs[0].energy.work, runs[1].energy.work, rtol=0, atol=1e-12)


def test_a_law_that_dissipates_books_no_work_and_one_that_drives_dissipates_nothing() -> None:
    passive = run(swinging("line", "duffing-numba", stiffness=20.0, damping=0.5), 0.5, 0.01).energy
    assert not np.any(passive.work)
    assert np.all(np.diff(passive.dissipated) >= 0.0)
    assert passive.dissipated[-1] > 0.01
    active = run(swinging("line", "pump-numba"), 0.5, 0.01).energy
    assert not np.any(active.dissipated)
    assert abs(active.work[-1]) > 0.001


@pytest.mark.parametrize("integrator", [RK4, GAUSS], ids=["rk4", "gauss"])
def test_a_mass_thrown_against_a_stop_comes_back_after_half_a_period(integrator: Any) -> None:
    # expected: free flight, x = -v/w sin(w (t - t1)) for half a period pi/w, free flight back; corners on step ends
    step, flight, contact = 0.01, 20, 50
    w = math.pi / (contact * step)
    speed, touch = 2.0, flight * step
    m = mass_on_a_line(speed * touch, -speed)
    m.law("stop", m.ground, "mass", law="one-sided", along="x", stiffness=w**2, acts="compression")
    found = run(m, (2 * flight + contact) * step, step, integrator)
    t = found.time
    held = np.where(t < touch, speed * (touch - t), -speed / w * np.sin(w * (t - touch)))
    expected = np.where(t > touch + math.pi / w, speed * (t - touch - math.pi / w), held)
    np.testing.assert_allclose(found["mass"].position[:, 0], expected, rtol=0, atol=2e-6 if integrator is RK4 else 1e-8)
    np.testing.assert_allclose(found.energy.balance, 0.0, atol=2e-5 if integrator is RK4 else 1e-8)


def test_a_stop_without_stiffness_but_damping_brakes_exponentially_and_never_pulls() -> None:
    # expected: from x = 0 on v = -v0 exp(-c t), so that it sinks in by v0/c; a step ends where it comes into touch
    c = 5.0
    m = mass_on_a_line(0.0, -1.0)
    m.law("mud", m.ground, "mass", law="one-sided", along="x", stiffness=0.0, damping=c, acts="compression")
    found = run(m, 2.0, 0.01)
    np.testing.assert_allclose(found["mass"].position[:, 0], -(1 - np.exp(-c * found.time)) / c, rtol=0, atol=1e-3)
    assert np.all(found["mass"].acceleration[:, 0] >= 0.0)


@pytest.mark.parametrize(("acts", "side"), [("tension", 1.0), ("compression", -1.0)])
@pytest.mark.parametrize("integrator", [RK4, {"name": "gauss", "stages": 2}], ids=["rk4", "gauss"])
def test_a_damped_one_sided_spring_never_acts_the_other_way(acts: str, side: float, integrator: Any) -> None:
    # expected: the force F = -m a has the sign of its side or is zero, leaving it as well as coming to it
    m = mass_on_a_line(1.0 - side * 0.2, side * 1.0)
    m.law("s", m.ground, "mass", law="one-sided", along="x", stiffness=60.0, damping=9.0, free_length=1.0, acts=acts)
    found = run(m, 1.0, 0.002, integrator)
    force = -side * found["mass"].acceleration[:, 0]
    beyond = side * (found["mass"].position[:, 0] - 1.0)
    assert np.all(force >= 0.0)
    assert np.max(force) > 1.0
    assert np.any(beyond > 1e-3)
    assert not np.any(force[beyond < 0.0])
    late = (beyond > 0.0) & (force == 0.0)  # in touch still, but the damper alone would hold it back
    assert np.any(late)
    assert np.all(np.diff(found.energy.dissipated) >= -1e-15)
    assert_within(found.energy.balance[-1], 1e-3)


def test_beyond_its_ends_a_table_goes_on_straight() -> None:
    # expected: accelerations -F(x) from SciPy's own spline, continued by its slope at the ends; potential by quadrature
    lengths, forces = np.array([0.0, 0.3, 0.5, 1.0]), np.array([-1.0, 0.2, 1.1, 5.0])
    spline = CubicSpline(lengths, forces)
    m = mass_on_a_line(0.6, 2.5)
    m.law("s", m.ground, "mass", law="table", along="x", table=[lengths, forces])
    found = run(m, 3.0, 0.01)
    x = found["mass"].position[:, 0]
    assert x.min() < -0.2
    assert x.max() > 1.2
    held = np.clip(x, 0.0, 1.0)
    np.testing.assert_allclose(
        -found["mass"].acceleration[:, 0], spline(held) + spline(held, 1) * (x - held), atol=1e-12
    )
    potential = [spline.integrate(0.0, b) for b in held] + (x - held) * (
        spline(held) + spline(held, 1) * (x - held) / 2
    )
    np.testing.assert_allclose(found.energy.potential, potential, rtol=0, atol=1e-12)


def test_a_disc_that_spins_and_pushes_itself_goes_in_a_circle_on_its_drift() -> None:
    # expected: m v' = R(w t) F with constant w, so v = F/(m w) (sin w t, 1 - cos w t) and x its integral
    w, force, mass = 3.0, 4.0, 2.0
    m = Mechanism(gravity=(0, 0))
    m.body("disc", mass=mass, inertia=0.5, angular_velocity=w)
    m.force("thrust", "disc", value=[force, 0.0], frame="body")
    found = run(m, 2.0, 0.02)
    t, size = found.time, force / (mass * w)
    expected = size * np.column_stack([(1 - np.cos(w * t)) / w, t - np.sin(w * t) / w])
    np.testing.assert_allclose(found["disc"].position[:, :2], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found["disc"].angle, w * t, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("law", "options"),
    [
        ("duffing-numba", {"stiffness": 200.0, "cubic": 500.0, "damping": 0.5}),
        ("table", {"table": [[0.0, 0.5, 1.0, 2.0], [-100.0, 0.0, 120.0, 500.0]], "damping": 0.5}),
    ],
    ids=["duffing", "table"],
)
@pytest.mark.parametrize("along", ["line", "angle", "x", "y"])
def test_newton_contracts_faster_with_smaller_steps(law: str, options: dict[str, Any], along: str) -> None:
    # expected: with exact tangents a change shrinks by O(h) in each iteration; a term left out would keep the rate
    counts = []
    for step in (0.01, 0.0025, 0.000625):
        found = run(swinging(along, law, **options), 0.2, step)
        counts.append(found.stats["newton_iterations"] / found.stats["steps"])
    assert counts[0] - 1.0 > counts[1] > counts[2] + 0.5
    assert counts[2] < 4.0


@pytest.mark.parametrize(("law", "is_known"), [("linear-sympy", True), ("linear-numba", False)])
def test_gradients_doubt_laws_whose_corners_are_not_known(law: str, is_known: bool) -> None:
    # expected: the gradient of the built-in spring
    options, times = {"stiffness": 40.0, "damping": 0.8, "free": 0.3}, {"end": 0.5, "step": 0.01}
    found, expected = (
        mbdkit.gradient(
            swinging("angle", one, **options), "final(bodies.lower.angle)", "model.forces.s.stiffness",
            check=False, integrator=GAUSS, time=times,
        )
        for one in (law, "built-in")
    )  # fmt: skip
    assert found.jacobian[0, 0] == pytest.approx(expected.jacobian[0, 0], rel=1e-9)
    assert expected.doubts == ()
    assert bool(found.doubts) != is_known
    assert is_known or "the law of the force 's' is a function" in found.doubts[0]


def test_passive_laws_that_supply_energy_are_named() -> None:
    # expected: a damper of -0.5 N s/m supplies the energy by which that of the mass increases
    specs = []
    for damping in (0.5, -0.5):
        m = mass_on_a_line(1.0, 2.0)
        m.law("spring", m.ground, "mass", law="linear-sympy", along="x", damping=damping)
        m.law("stop", m.ground, "mass", law="one-sided", along="x", stiffness=1.0, acts="compression")
        specs.append({"mbdkit": 1, "model": m.to_spec(), "integrator": RK4, "time": {"end": 1.0, "step": 0.01}})
    sound, wrong = (mbdkit.run(spec) for spec in specs)
    assert sound.warnings == []
    (told,) = wrong.verdict_reasons
    supplied = 0.5 * 2.0**2 * (math.exp(1.0) - 1.0)
    assert told.startswith(
        f"the dissipated energy decreases by up to {supplied:.3g} J, because one of the laws acme:linear-sympy of "
        "force 'spring' and mbdkit:one-sided of force 'stop' supplies energy although it is declared passive"
    )
    key = "model.forces.spring.damping"
    study = mbdkit.ensemble(specs[0], {key: [0.5, -0.5]}, store="hashes")  # in lanes
    assert list(study.columns()["verdict"]) == [sound.verdict, wrong.verdict]
