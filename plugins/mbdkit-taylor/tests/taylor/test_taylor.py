"""The integrator taylor against SciPy and dop853: motion, energies, dense output, events, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.base.errors import SpecError, UnsupportedMechanismError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit_taylor.kernels.power_series import EXPANDED
from tests.engine.random_mechanisms import chain, loop, slides, tree
from tests.integrators.pendulums_on_joints import floating, forced_pendulum, lagrange
from tests.margins import assert_within
from tests.witness.double_pendulum import HORIZONTAL

JOINT = "joint-coordinates"
TIGHT = {"name": "taylor", "adaptive": True, "rtol": 1e-13, "atol": 1e-13}
VALUE = "1.5*sin(2*t)**3/(2 + cos(t)) - exp(-t**2)*log(3 + t) + sqrt(1 + t)*(t - 4)**-2 - 0.5"
"""A load with every operation whose series is known."""


def loaded(rng: np.random.Generator) -> Mechanism:
    """Return a tree of pins and a free body with every force that has a series."""
    m = floating(rng)
    m.spring_damper("between", "r1", "root", points=((0.1, 0.2), (-0.3, 0.1)), stiffness=40.0, damping=2.0)
    m.spring_damper("to-ground", m.ground, "a", points=((0.5, 2.0), (0.2, -0.1)), stiffness=30.0, free_length=0.4)
    m.torsion_spring("coil", "r0", "r2", stiffness=5.0, damping=0.3, free_angle=0.7)
    m.torsion_spring("coil-to-ground", m.ground, "r3", stiffness=2.0)
    m.torque("motor", "r2", value=VALUE, reaction_body="r0")
    m.force("push", "r4", point=(0.2, -0.1), value=("0.8*cos(3*t)", "t**3"))
    m.force("thrust", "root", point=(0.1, 0.3), value=("2*exp(-t)", "1"), frame="body")
    return m


MECHANISMS: dict[str, Callable[[np.random.Generator], Mechanism]] = {
    "chain": chain, "tree": tree, "floating": floating, "loaded": loaded,
}  # fmt: skip


def test_every_operation_with_a_series_is_in_the_value_of_the_motor() -> None:
    words = {"mul": "*", "add": "+", "sub": "-", "div": "/", "powi": "**", "neg": "(-", "const": "0.5"}
    assert all(words.get(name, name) in VALUE.replace("exp(-", "exp((-") for name in EXPANDED)


@pytest.mark.parametrize("kind", MECHANISMS)
@pytest.mark.parametrize("order", [None, 7])
def test_motion_energies_and_reactions_are_those_of_dop853_in_the_coordinates_of_the_bodies(
    kind: str, order: int | None
) -> None:
    # expected: another method on other equations, with multipliers
    reference = {"name": "dop853", "adaptive": True, "rtol": 1e-13, "atol": 1e-13}
    ours, theirs = (
        mbdkit.run(MECHANISMS[kind](np.random.default_rng(1)), formulation=one, integrator=method, time={"end": 0.2})
        for one, method in ((JOINT, TIGHT | ({"order": order} if order else {})), ("index-1", reference))
    )
    ours.check()
    for name, body in theirs.bodies.items():
        for part in ("position", "angle", "velocity", "angular_velocity"):
            expected = getattr(body, part)[-1]
            np.testing.assert_allclose(getattr(ours.bodies[name], part)[-1], expected, rtol=1e-10, atol=1e-10)
    largest = max(float(np.max(np.abs(joint.reaction_force))) for joint in theirs.joints.values())
    for name, joint in theirs.joints.items():
        mine = ours.joints[name]
        np.testing.assert_allclose(mine.reaction_force[-1], joint.reaction_force[-1], rtol=0, atol=1e-9 * largest)
        assert_within(mine.misalignment[1:], 1e-14)
    for name in ("work", "dissipated"):
        assert getattr(ours.energy, name)[-1] == pytest.approx(getattr(theirs.energy, name)[-1], abs=1e-9)


@pytest.mark.parametrize("order", [4, 5])
def test_fixed_steps_have_the_order_of_the_series(order: int) -> None:
    # expected: Lagrange's equations by DOP853 at 1e-13
    expected = solve_ivp(lagrange, (0.0, 1.0), [-1.0, -0.4, 0.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    errors = []
    for steps in (100, 200):
        integrator = {"name": "taylor", "order": order}
        run = mbdkit.run(
            forced_pendulum(), formulation=JOINT, integrator=integrator, time={"end": 1.0, "step": 1.0 / steps}
        )
        rods = run.bodies["r0"], run.bodies["r1"]
        found = [*(one.angle[-1] for one in rods), *(one.angular_velocity[-1] for one in rods)]
        errors.append(np.max(np.abs(np.array(found) - expected)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)  # margin: order, from errors of mbdkit alone


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8, 1e-9, 1e-11, 1e-14])
def test_the_double_pendulum_from_rest_at_the_horizontal(rtol: float) -> None:
    # expected: digits by extrapolation in extended precision; three of four coefficients of the first step are zero
    end = HORIZONTAL.times[HORIZONTAL.at(5.0)]
    run = mbdkit.run(
        {
            "mbdkit": 1, "model": {"name": "double-pendulum"}, "formulation": JOINT, "time": {"end": end},
            "integrator": {"name": "taylor", "adaptive": True, "rtol": rtol, "atol": rtol},
        }
    )  # fmt: skip
    error = np.max(np.abs(run["rod2"].position[-1] - HORIZONTAL.positions[HORIZONTAL.at(5.0), 1]))
    assert_within(error, max(200 * rtol, 2e-11))


def spec(**changes: Any) -> dict[str, Any]:
    """Return the spec of a run of the double pendulum."""
    return {
        "mbdkit": 1, "model": {"name": "double-pendulum", "angles": [0.3, -0.8]}, "formulation": JOINT,
        "integrator": {"name": "taylor", "adaptive": True, "rtol": 1e-11, "atol": 1e-11}, "time": {"end": 1.0},
    } | changes  # fmt: skip


def test_rows_within_steps_and_events_are_those_of_small_steps() -> None:
    # expected: dop853 at the same times in steps of 1 ms, whose error is 1e-13
    small = mbdkit.run(spec(integrator={"name": "dop853"}, time={"end": 1.0, "step": 0.001}, output={"every": 25}))
    events = {"level": {"when": "rod1.angle", "direction": "falling"}}
    run = mbdkit.run(spec(output={"interval": 0.025}, events=events))
    np.testing.assert_allclose(run.time, small.time, atol=1e-12)
    for rod in ("rod1", "rod2"):
        np.testing.assert_allclose(run[rod].position, small[rod].position, atol=1e-10)
        np.testing.assert_allclose(run[rod].velocity, small[rod].velocity, atol=1e-9)
    assert_within(run.joints["J2"].misalignment, 1e-15)
    at = float(run.events.of_name("level").time[0])
    whole = mbdkit.run(spec(time={"end": at}))
    assert whole["rod1"].angle[-1] == pytest.approx(0.0, abs=1e-9)


def test_integrals_of_measures_use_the_nodes_of_the_steps() -> None:
    # expected: the change of a coordinate is the integral of its rate
    run = mbdkit.run(spec(), measures={"path": "integral(rod2.vx)"})
    moved = run["rod2"].position[-1, 0] - run["rod2"].position[0, 0]
    assert run.measures["path"] == pytest.approx(moved, abs=1e-10)


def test_two_runs_are_the_same_bit_for_bit_also_if_one_stops_on_the_way() -> None:
    ends = [mbdkit.run(spec(output=output)).data_sha256 for output in ({}, {}, {"every": 3})]
    assert ends[0] == ends[1] != ends[2]


def pulled(value: Any) -> Mechanism:
    """Return a chain with a torque."""
    m = chain(np.random.default_rng(1), 2)
    m.torque("motor", "r1", value=value)
    return m


@pytest.mark.parametrize(
    ("mechanism", "why"),
    [
        (loop(np.random.default_rng(1)), "closed loops, joints other than pins"),
        (slides(np.random.default_rng(1)), "closed loops, joints other than pins"),
        (pulled("-0.1*r1.angular_velocity"), "loads that depend on the state"),
        (pulled("abs(sin(t))"), "functions other than sin, cos"),
    ],
    ids=["loop", "slides", "state", "abs"],
)
def test_a_mechanism_without_series_is_refused_before_the_first_step(mechanism: Mechanism, why: str) -> None:
    with pytest.raises(UnsupportedMechanismError, match=f"^integrator: .*{why}.*use dop853"):
        mbdkit.run(mechanism, formulation=JOINT, integrator=TIGHT, time={"end": 0.1})


def test_another_formulation_is_refused() -> None:
    with pytest.raises(SpecError, match="'taylor' does not support the formulation 'index-1', only joint-coordinates"):
        mbdkit.run(spec(formulation="index-1"))
