"""Forces of closed contacts: the equations that they satisfy, in random states of boxes, a disc and a jointed arm."""

from __future__ import annotations

import numpy as np
import pytest

import mbdkit
from mbdkit import EquationsOfMotion
from mbdkit.mechanism.contacts import OPEN, SLIP, STICK
from mbdkit_contact.rigid_contacts import RigidContacts

SQUARE = {"polygon": [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]}
FLOOR = {"line": {"normal": [0.0, 1.0]}}
T = 0.1


def contacts_of(*, slope: float = 0.0, only_box: bool = False) -> RigidContacts:
    """Return the contacts of a mechanism, whose equations of motion are ``contacts.p``."""
    bodies = {
        "box": {"mass": 1.0, "inertia": 0.2, "position": [0.0, 0.5]},
        "top": {"mass": 2.0, "inertia": 0.3, "position": [0.1, 1.5]},
        "disc": {"mass": 0.5, "inertia": 0.1, "position": [1.0, 0.5]},
        "arm": {"mass": 2.0, "inertia": 0.3, "position": [3.0, 0.0]},
    }
    contacts = {
        "floor": {"bodies": ["ground", "box"], "shapes": [FLOOR, SQUARE], "friction": 0.5},
        "stack": {"bodies": ["box", "top"], "shapes": [SQUARE, SQUARE], "friction": 0.4},
        "side": {"bodies": ["box", "disc"], "shapes": [SQUARE, {"circle": {"radius": 0.5}}], "friction": 0.3},
        "tip": {"bodies": ["ground", "arm"], "shapes": [FLOOR, {"point": [0.5, 0.0]}], "friction": 0.3},
    }
    joints = {"pin": {"type": "revolute", "bodies": ["ground", "arm"], "at": [2.5, 0.0]}}
    if only_box:
        bodies, contacts, joints = {"box": bodies["box"]}, {"floor": contacts["floor"]}, {}
    model = {
        "name": "mechanism", "gravity": [9.81 * np.sin(slope), -9.81 * np.cos(slope)], "bodies": bodies,
        "joints": joints, "contacts": contacts,
    }  # fmt: skip
    spec = {"mbdkit": 1, "model": model, "contact": {"treatment": "event-driven"}, "integrator": {"name": "rk4"}}
    equations = EquationsOfMotion.of(mbdkit.RunSpec(**spec, time={"end": 1.0, "step": 0.1}).mechanism())
    return RigidContacts.on(equations)


def test_accelerations_and_forces_satisfy_the_equations_of_motion_and_the_laws_of_the_modes() -> None:
    contacts, random = contacts_of(), np.random.default_rng(53)
    p, redundant = contacts.p, 0
    for _ in range(100):
        q, v = p.q0 + 0.02 * random.standard_normal(p.n), random.standard_normal(p.n)
        modes = np.full(len(contacts.names), OPEN)
        some = random.choice(len(modes), random.integers(0, 6), replace=False)
        modes[some] = random.choice([STICK, SLIP, -SLIP], len(some))
        forced = contacts.accelerations(T, q, v, modes)
        rows, size = forced.rows, 1.0 + max(np.abs(forced.a).max(), np.abs(forced.normal).max(initial=0.0))
        close = {"rtol": 0.0, "atol": 1e-9 * size}
        push = rows.normal.T @ forced.normal + rows.tangent.T @ forced.tangent
        np.testing.assert_allclose(p.residual(T, q, v, forced.a, forced.multipliers), push, **close)
        np.testing.assert_allclose(p.constraint_jacobian(T, q) @ forced.a, p.gamma(T, q, v), **close)
        np.testing.assert_array_equal(forced.normal[modes == OPEN], 0.0)
        slips = np.abs(modes) == SLIP
        friction = -np.sign(modes[slips]) * contacts.kinetic[slips] * forced.normal[slips]
        np.testing.assert_allclose(forced.tangent[slips], friction, **close)
        held = np.vstack([rows.normal[modes != OPEN], rows.tangent[modes == STICK]])
        if np.linalg.matrix_rank(np.vstack([held, p.constraint_jacobian(T, q).toarray()])) < len(held) + p.m:
            redundant += 1  # more constraints than can be met
            continue
        right = np.concatenate([rows.normal_right[modes != OPEN], rows.tangent_right[modes == STICK]])
        np.testing.assert_allclose(held @ forced.a, right, **close)
    assert redundant < 70


def test_contacts_that_stick_share_friction_in_proportion_to_their_normal_forces() -> None:
    # expected: a block at rest on a slope; weight times cosine and sine, and moments about its centre
    slope = 0.3
    contacts = contacts_of(slope=slope, only_box=True)
    p = contacts.p
    modes = np.array([STICK, STICK, OPEN, OPEN])
    forced = contacts.accelerations(T, p.q0, 0.0 * p.q0, modes)
    np.testing.assert_allclose(forced.a, 0.0, atol=1e-12)
    assert forced.normal.sum() == pytest.approx(9.81 * np.cos(slope), rel=1e-12)
    assert np.abs(forced.tangent.sum()) == pytest.approx(9.81 * np.sin(slope), rel=1e-12)
    assert np.ptp(forced.normal[:2]) == pytest.approx(9.81 * np.sin(slope), rel=1e-12)
    assert np.ptp(forced.tangent[:2] / forced.normal[:2]) == pytest.approx(0.0, abs=1e-9)


def test_solutions_hold_the_gaps_of_closed_contacts_with_the_smallest_change() -> None:
    # expected: M x + Phi_q^T mu differs from the given force by forces of the contacts alone
    contacts, random = contacts_of(), np.random.default_rng(5)
    p = contacts.p
    modes = np.full(len(contacts.names), OPEN)
    modes[[0, 1, contacts.names.index("tip")]] = STICK, SLIP, STICK
    q, force = p.q0 + 0.02 * random.standard_normal(p.n), random.standard_normal(p.n)
    rows = contacts.kinematics.rows(q, 0.0 * q)
    closed, sticks = rows.normal[modes != OPEN], rows.tangent[modes == STICK]
    jacobian = p.constraint_jacobian(T, q).toarray()
    for held in (closed, np.vstack([closed, sticks])):
        constraints = np.vstack([jacobian, held])
        given = constraints @ random.standard_normal(p.n)  # which some motion satisfies
        x, mu = contacts.solution(T, q, force, given, modes)
        np.testing.assert_allclose(constraints @ x, given, rtol=0, atol=1e-9)
        left = p.mass * x + jacobian.T @ mu - force
        forces = np.linalg.lstsq(held.T, left, rcond=None)[0]
        np.testing.assert_allclose(held.T @ forces, left, rtol=0, atol=1e-9)
