"""Forces of closed contacts: the equations that they satisfy, in random states of boxes, a disc and a jointed arm."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from tests.rigid.states_of_contacts import rows_in

import mbdkit
from mbdkit import EquationsOfMotion
from mbdkit_contact.events_of_contacts import ContactEvents
from mbdkit_contact.forced_equations import ForcedEquations
from mbdkit_contact.kernels.kinematics import hold
from mbdkit_contact.modes import OPEN, SLIP, STICK
from tests.margins import assert_within

SQUARE = {"polygon": [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]}
FLOOR = {"line": {"normal": [0.0, 1.0]}}
T = 0.1


def contacts_of(*, slope: float = 0.0, only_box: bool = False) -> ContactEvents:
    """Return the contacts of a mechanism, whose equations of motion are ``events.p``."""
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
    return ContactEvents(EquationsOfMotion.of(mbdkit.RunSpec(**spec, time={"end": 1.0, "step": 0.1}).mechanism()))


class Forced(NamedTuple):
    """Accelerations (n,), multipliers (m,), normal and friction forces (C,) in a state; accelerations (n,) that steps
    compute from independent forces.
    """

    a: np.ndarray
    multipliers: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    within_step: np.ndarray


def forced(events: ContactEvents, q: np.ndarray, v: np.ndarray, modes: np.ndarray) -> Forced:
    """Return what contacts in given modes cause."""
    put(events, q, v, modes)
    events.show_forces()
    bundle, basis = events.bundle, events.bundle.known.basis
    kept, basis[0] = basis[0], 0  # without known independent forces, all are computed
    with events.acting():
        a, multipliers = ForcedEquations(events).accelerations(T, q, v)
        basis[0] = kept
        within_step = ForcedEquations(events).accelerations(T, q, v)[0]
    np.testing.assert_allclose(bundle.a[: len(q)], a, rtol=0.0, atol=1e-12 * (1.0 + np.abs(a).max()))
    return Forced(a, multipliers, bundle.normal.copy(), bundle.tangent.copy(), within_step)


def put(events: ContactEvents, q: np.ndarray, v: np.ndarray, modes: np.ndarray) -> None:
    """Look at a state with contacts in given modes, at the features nearest to touching."""
    events.load({})
    shapes = events.contacts.shapes
    shapes.held[:] = -1
    hold(shapes, q, modes != OPEN)
    events.load(events.state().known | {"modes": modes.astype(float), "features": shapes.held.astype(float)})
    events.at(T, q, v, np.zeros(0))


def test_accelerations_and_forces_satisfy_the_equations_of_motion_and_the_laws_of_the_modes() -> None:
    events, random = contacts_of(), np.random.default_rng(53)
    contacts, p, redundant = events.contacts, events.p, 0
    for _ in range(100):
        q, v = p.q0 + 0.02 * random.standard_normal(p.n), random.standard_normal(p.n)
        modes = np.full(len(contacts.names), OPEN)
        some = random.choice(len(modes), random.integers(0, 6), replace=False)
        modes[some] = random.choice([STICK, SLIP, -SLIP], len(some))
        a, multipliers, normal, tangent, within_step = forced(events, q, v, modes)
        rows, size = rows_in(contacts.shapes, q, v), 1.0 + max(np.abs(a).max(), np.abs(normal).max(initial=0.0))
        close = {"rtol": 0.0, "atol": 1e-9 * size}
        push = rows.normal.T @ normal + rows.tangent.T @ tangent
        np.testing.assert_allclose(p.residual(T, q, v, a, multipliers), push, **close)
        np.testing.assert_allclose(p.constraint_jacobian(T, q) @ a, p.gamma(T, q, v), **close)
        np.testing.assert_array_equal(normal[modes == OPEN], 0.0)
        slips = np.abs(modes) == SLIP
        friction = -np.sign(modes[slips]) * contacts.coefficients[slips, 2] * normal[slips]
        np.testing.assert_allclose(tangent[slips], friction, **close)
        held = np.vstack([rows.normal[modes != OPEN], rows.tangent[modes == STICK]])
        every = np.vstack([held, p.constraint_jacobian(T, q).toarray()])
        if np.linalg.matrix_rank(every) < len(every):
            redundant += 1  # more constraints than can be met
            continue
        sizes = np.linalg.svd(every, compute_uv=False)  # the equations of forces have the square of the condition
        error = 1e-12 * size * (sizes[0] / sizes[-1]) ** 2 if len(every) else 0.0
        np.testing.assert_allclose(within_step, a, rtol=0.0, atol=min(error, 1e-6 * size))
        right = np.concatenate([rows.normal_right[modes != OPEN], rows.tangent_right[modes == STICK]])
        np.testing.assert_allclose(held @ a, right, **close)
    assert redundant < 70


def test_contacts_that_stick_share_friction_in_proportion_to_their_normal_forces() -> None:
    # expected: a block at rest on a slope; weight times cosine and sine, and moments about its centre
    slope = 0.3
    events = contacts_of(slope=slope, only_box=True)
    modes = np.array([STICK, STICK, OPEN, OPEN])
    a, _, normal, tangent, _ = forced(events, events.p.q0, 0.0 * events.p.q0, modes)
    np.testing.assert_allclose(a, 0.0, atol=1e-12)
    assert normal.sum() == pytest.approx(9.81 * np.cos(slope), rel=1e-12)
    assert np.abs(tangent.sum()) == pytest.approx(9.81 * np.sin(slope), rel=1e-12)
    assert np.ptp(normal[:2]) == pytest.approx(9.81 * np.sin(slope), rel=1e-12)
    assert np.ptp(tangent[:2] / normal[:2]) == pytest.approx(0.0, abs=1e-9)


def test_closed_contacts_and_joints_are_closed_with_the_smallest_change() -> None:
    # expected: gaps, joints and slips of contacts that stick vanish; changes are caused by forces of these alone
    events, random = contacts_of(), np.random.default_rng(5)
    p = events.p
    modes = np.full(len(events.contacts.names), OPEN)
    modes[[0, 1, events.contacts.names.index("tip")]] = STICK, SLIP, STICK
    for _ in range(20):
        q, v = p.q0 + 1e-3 * random.standard_normal(p.n), random.standard_normal(p.n)
        put(events, q, v, modes)
        events.close()
        new_q, new_v = events.bundle.q[: p.n], events.bundle.v[: p.n]
        rows = rows_in(events.contacts.shapes, new_q, new_v)
        assert_within(rows.gap[modes != OPEN], 1e-12)
        assert_within(p.constraints(T, new_q), 1e-12)
        assert_within(p.constraint_rates(T, new_q, new_v), 1e-12)
        gaps, slips = rows.normal @ new_v, rows.tangent @ new_v
        assert_within(max(np.abs(gaps[modes != OPEN]).max(), np.abs(slips[modes == STICK]).max()), 1e-12)
        closed, sticks = rows.normal[modes != OPEN], rows.tangent[modes == STICK]
        jacobian = p.constraint_jacobian(T, new_q).toarray()
        for change, held in ((new_q - q, closed), (new_v - v, np.vstack([closed, sticks]))):
            directions, moved = np.vstack([jacobian, held]).T, p.mass * change
            forces = np.linalg.lstsq(directions, moved, rcond=None)[0]
            np.testing.assert_allclose(directions @ forces, moved, rtol=0, atol=1e-10)


@pytest.mark.parametrize("basis", [[2, 0, 10**9], [2, 0, -1], [10**9, 0, 0], [1, 2, 0]])
def test_equations_that_do_not_exist_are_refused(basis: list[int]) -> None:
    """They may come from a checkpoint, and kernels use them as indices."""
    events = contacts_of(only_box=True)
    known = events.bundle.known
    known.modes[:2] = SLIP  # two forces
    known.basis[:3] = [2, 0, 1]
    events.check_indices()
    known.basis[:3] = basis
    with pytest.raises(ValueError, match="does not exist"):
        events.check_indices()
