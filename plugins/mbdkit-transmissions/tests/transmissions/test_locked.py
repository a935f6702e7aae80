"""Joints that hold each other still are named; forces of mechanisms that cannot move are good."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import null_space

import mbdkit
from mbdkit import Mechanism

GAUSS = {"name": "gauss", "stages": 2}
DOP = {"name": "dop853", "adaptive": True}


def doubts(m: Mechanism, integrator: dict[str, Any] = GAUSS, **sections: Any) -> tuple[mbdkit.Run, list[str]]:
    time = {"end": 0.1} | ({} if integrator.get("adaptive") else {"step": 0.01})
    run = mbdkit.run({"mbdkit": 1, "model": m.to_spec(), "integrator": integrator, "time": time} | sections)
    return run, [str(warning) for warning in run.warnings if "still" in str(warning)]


def wheels(*places: float) -> Mechanism:
    """Wheels w0, w1, ... on pins of the ground, of which a torque of 1 N m turns the first."""
    m = Mechanism(gravity=(0, 0))
    for i, x in enumerate(places):
        m.body(f"w{i}", mass=1, inertia=0.01, position=(x, 0))
        m.revolute(f"P{i}", m.ground, f"w{i}", at=(x, 0))
    m.torque("T", "w0", value=1.0)
    return m


def geared(ratio: float) -> Mechanism:
    m = wheels(0.0, 0.3)
    m.gear("G", "w0", "w1", radii=(0.1, 0.2), pressure_angle=0.0)
    m.coupling("K", "w0", "w1", equation=f"second - {ratio}*first")
    return m


@pytest.mark.parametrize("integrator", [GAUSS, DOP])
def test_a_gear_and_a_coupling_that_contradict_each_other_are_named(integrator: dict[str, Any]) -> None:
    run, found = doubts(geared(0.7), integrator)
    assert run.status == "complete"
    assert list(run.verdict_reasons) == found
    assert "'P0', 'P1', 'G' and 'K' hold their bodies still, so that joints 'G' and 'K' can" in found[0]
    # moments about both axes: 0.1 F - 0.7 K = 1 and 0.2 F + K = 0, with the force F of the teeth
    np.testing.assert_allclose(np.hypot(*run.joints["G"].reaction_force[-1]), 1 / (0.1 + 0.7 * 0.2), rtol=1e-9)


def test_a_gear_and_a_coupling_that_agree_are_not_named() -> None:
    assert not doubts(geared(-0.5))[1]


def test_a_train_that_is_locked_across_a_weld_is_named_although_a_pendulum_moves() -> None:
    m = wheels(0.0, 0.5)
    m.gravity = (0.0, -9.81)
    m.body("w2", mass=1, inertia=0.01, position=(0.5, 0))
    m.weld("W", "w1", "w2", at=(0.5, 0))
    m.belt("G", "w0", "w1", radii=(0.1, 0.2))
    m.belt("H", "w0", "w2", radii=(0.1, 0.15))
    m.body("rod", mass=1, inertia=0.01, position=(3, 0))
    m.revolute("Q", m.ground, "rod", at=(2, 0))
    (sentence,) = doubts(m)[1]
    assert "'P0', 'P1', 'W', 'G' and 'H' hold their bodies still, so that joints 'G' and 'H' can" in sentence


def test_what_a_driver_holds_or_what_stands_at_a_dead_centre_is_not_locked() -> None:
    m = wheels(0.0, 0.3)
    m.gear("G", "w0", "w1", radii=(0.1, 0.2))
    m.driver("D", m.ground, "w0", coordinate="angle", motion="0.0")
    assert not doubts(m)[1]
    m = wheels(0.0)  # a crank at its dead centre, unloaded
    m.forces = {}
    m.body("slider", mass=1, inertia=0.01, position=(0.5, 0))
    m.body("rod", mass=1, inertia=0.01, position=(0.3, 0))
    m.body("pinion", mass=1, inertia=0.01, position=(0.5, 0.1))
    m.revolute("B", "w0", "rod", at=(0.1, 0))
    m.revolute("C", "rod", "slider", at=(0.5, 0))
    m.prismatic("S", m.ground, "slider", at=(0.5, 0), axis=(1, 0))
    m.revolute("E", m.ground, "pinion", at=(0.5, 0.1))
    m.rack("R", "pinion", "slider", radius=0.1)
    assert not doubts(m)[1]


@pytest.mark.parametrize("seed", range(8))
def test_drawn_trains_are_locked_where_the_null_space_of_their_ratios_says_so(seed: int) -> None:
    generator = np.random.default_rng(seed)
    count = int(generator.integers(2, 5))
    m, ratios = wheels(*(0.4 * i for i in range(count))), []
    for k in range(int(generator.integers(1, count + 2))):
        i, j = sorted(generator.choice(count, 2, replace=False).tolist())
        ratio = float(generator.choice([-2.0, -1.0, 0.5, 1.0, 3.0]))
        m.coupling(f"J{k}", f"w{i}", f"w{j}", equation=f"second - {ratio}*first")
        ratios.append([ratio if n == i else -1.0 if n == j else 0.0 for n in range(count)])
    moving = np.abs(null_space(np.array(ratios))).max(axis=1, initial=0.0) > 1e-9
    wanted = {f"'J{k}'" for k, row in enumerate(ratios) if not moving[np.flatnonzero(row)].any()}
    found = doubts(m)[1]
    named = found[0].split("so that")[1] if found else ""
    assert {f"'J{k}'" for k in range(len(ratios)) if f"'J{k}'" in named} == wanted


@pytest.mark.parametrize("tilt", [0.821770123928726, 1.830017542472281, 0.750572799628002])
def test_a_wheel_that_nothing_presses_does_not_pull_by_rounding_errors(tilt: float) -> None:
    along = np.array([np.cos(tilt), np.sin(tilt)])
    (ex, ey), (x, y) = along.tolist(), (0.3 * np.array([-along[1], along[0]])).tolist()
    m = Mechanism(gravity=(0, 0))
    m.body("wheel", mass=1, inertia=0.01, position=(x, y))
    m.rolling("R", m.ground, "wheel", radius=0.3, axis=(ex, ey))
    m.force("F", "wheel", value=(10 * ex, 10 * ey), at=(x, y))
    run, _ = doubts(m)
    assert np.abs(run.array("constraints/multiplier")[:, 0]).max() < 1e-13
    assert not run.verdict_reasons
