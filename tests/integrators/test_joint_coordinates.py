"""The formulation joint-coordinates: spanning trees, motion and reactions, orders, drift, lanes, refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.studies import test_lanes

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.kernels.constraints import KINDS as CONSTRAINTS
from mbdkit.engine.kernels.table_rows import PAIR
from mbdkit.engine.kernels.tree import PLACE, TURN
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.spanning_tree import cut_joints, is_tree_of_pins, spanning_tree
from mbdkit.mechanism.mechanism import Mechanism
from tests.integrators.pendulums_on_joints import JOINT, KINDS, forced_pendulum, lagrange
from tests.margins import assert_within

from .running import EPS, assert_same_end

TIGHT = {"name": "dop853", "adaptive": True, "rtol": 1e-12, "atol": 1e-12}


@pytest.mark.parametrize("kind", KINDS)
def test_a_spanning_tree_has_the_coordinates_counted_by_hand(kind: str) -> None:
    make, cut, count = KINDS[kind]
    compiled = compile_mechanism(make(np.random.default_rng(1)))
    found = spanning_tree(compiled.topology)
    kinds = compiled.topology.pairs[found[:, PLACE], PAIR.kind]
    line = (kinds == CONSTRAINTS["point_on_line"]) & (found[:, PLACE] >= 0)
    free = 2 * np.sum(found[:, PLACE] < 0) + np.sum(line) + np.sum(found[:, TURN] < 0)
    assert (set(cut_joints(compiled)), int(free)) == (cut, count)
    assert is_tree_of_pins(compiled.topology, found) == (kind in ("chain", "tree", "floating", "laws"))


@pytest.mark.parametrize("kind", KINDS)
def test_motion_and_every_reaction_are_those_in_the_coordinates_of_the_bodies(kind: str) -> None:
    # expected: index-1 in absolute coordinates, which solves for the multipliers of all joints; pins fall to round-off
    make, cut, _ = KINDS[kind]
    settings: dict[str, Any] = {"integrator": TIGHT, "time": {"end": 0.2}}
    ours, theirs = (
        mbdkit.run(make(np.random.default_rng(1)), formulation=one, **settings) for one in (JOINT, "index-1")
    )
    size = assert_same_end(ours, theirs)
    for name, mine in ours.joints.items():
        if name not in cut:
            assert np.max(mine.misalignment[1:]) <= 4 * EPS * size, name
            assert_within(mine.velocity_misalignment[1:], 1e-13 * size)


@pytest.mark.parametrize(("method", "order", "steps"), [("rk4", 4, 100), ("rk-gill", 4, 100), ("dopri5", 5, 200)])
def test_methods_keep_their_order(method: str, order: int, steps: int) -> None:
    # expected: Lagrange's equations by DOP853 at 1e-13
    expected = solve_ivp(lagrange, (0.0, 2.0), [-1.0, -0.4, 0.0, 0.0], "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    errors = []
    for n in (steps, 2 * steps):
        run = mbdkit.run(
            forced_pendulum(), formulation=JOINT, integrator={"name": method}, time={"end": 2.0, "step": 2.0 / n}
        )
        rods = run.bodies["r0"], run.bodies["r1"]
        found = [*(one.angle[-1] for one in rods), *(one.angular_velocity[-1] for one in rods)]
        errors.append(np.max(np.abs(np.array(found) - expected)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)  # margin: order, from errors of mbdkit alone


@pytest.mark.parametrize("method", ["rk4", "dopri5"])
def test_pins_stay_closed_to_the_last_bits_over_many_turns(method: str) -> None:
    spec = {"mbdkit": 1, "model": {"name": "double-pendulum", "rates": [20.0, 30.0]}, "integrator": {"name": method}}
    run = mbdkit.run(spec, formulation=JOINT, time={"end": 40.0, "step": 0.02}, output={"every": 500})
    assert run.bodies["rod2"].angle[-1] > 200.0
    assert max(joint.misalignment_max for joint in run.joints.values()) <= 4 * EPS * 2.0


def test_cut_joints_drift_until_they_are_projected() -> None:
    make, cut, _ = KINDS["loop"]
    settings: dict[str, Any] = {"integrator": {"name": "rk4"}, "time": {"end": 0.5, "step": 0.005}}
    drift = {}
    for kind in ("none", "baumgarte", "projection"):
        run = mbdkit.run(make(np.random.default_rng(1)), formulation=JOINT, stabilization=kind, **settings)
        drift[kind] = max(run.joints[name].misalignment_max for name in cut)
        kept = [joint.misalignment_max for name, joint in run.joints.items() if name not in cut]
        assert_within(max(kept), 1e-13 if kind == "projection" else 16 * EPS)
    assert drift["projection"] < 1e-13 < drift["none"]


@pytest.mark.parametrize("kind", ["chain", "slides", "rolling", "springs", "laws"])
def test_lanes_have_the_bits_of_single_runs(kind: str) -> None:
    # expected: the driver of single runs, compiled from the same source for numbers
    planned = test_lanes.tables(WIDTH)
    workspaces = [replace(one, formulation=JOINT) for one in test_lanes.workspaces_of(kind, planned)]
    results = test_lanes.advanced("dopri5", workspaces, planned)
    spanned = test_lanes.spans(WIDTH, test_lanes.RECORDED["adaptive dop853"])
    others = [replace(one, formulation=JOINT) for one in test_lanes.workspaces_of(kind, spanned)]
    controlled = test_lanes.controlled("adaptive dop853", others, spanned)
    for lane in range(WIDTH):
        test_lanes.assert_same_bits(results, lane, "dopri5", workspaces[lane], planned[lane])
        test_lanes.assert_same_bits(controlled, lane, "adaptive dop853", others[lane], spanned[lane])


REFUSED = {
    "stabilization.symmetric": {"stabilization": {"name": "projection", "symmetric": True}},
    "formulation": {"integrator": {"name": "rattle"}},
}


@pytest.mark.parametrize("key", REFUSED)
def test_what_joint_coordinates_cannot_do_is_refused_in_a_sentence(key: str) -> None:
    settings: dict[str, Any] = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.01}, **REFUSED[key]}
    with pytest.raises(SpecError, match=r"joint.coordinates") as error:
        mbdkit.run(forced_pendulum(), formulation=JOINT, **settings)
    assert error.value.key == key


def test_friction_in_joints_acts_in_joint_coordinates() -> None:
    m = Mechanism()
    m.body("rod", mass=2.0, inertia=0.1, position=(0.5, 0.0))
    m.revolute("pin", m.ground, "rod", at=(0.0, 0.0), friction={"coefficient": 0.3, "radius": 0.05})
    last = []
    for formulation in ("index-1", "joint-coordinates"):
        spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "dop853"}, "formulation": formulation}
        with mbdkit.run(spec, time={"end": 1.0, "step": 0.01}) as done:
            last.append([*done["rod"].velocity[-1], done.joints["pin"].friction[-1], done.energy.dissipated[-1]])
    assert last[1] == pytest.approx(last[0], rel=1e-7)
    assert last[0][-1] > 0.1
