"""Random mechanisms, each of which has to keep every promise of the engine.

The claims draw the same mechanisms, batch by batch; `MBDKIT_BATCHES=2-19` draws others, and 100-299 for a night.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, assume, given, seed, settings

import mbdkit
from mbdkit.archive.run import Run
from mbdkit.engine.assembly import assemble
from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.kernels.observe import tangents_at
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.beams import parts_of
from mbdkit.mechanism.joints import Revolute, Weld
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import load_spec
from mbdkit.spec.yaml_reader import read_yaml, write_yaml
from tests.margins import assert_within

from .by_hand import ByHand, cross, derivatives, first_derivative, second_derivative, steps_along
from .strategies import LONGEST, Drawn, mechanisms

FIRST, LAST = (int(x) for x in os.environ.get("MBDKIT_BATCHES", "0-1").split("-"))

PER_BATCH = 12
"""Two of them are small. Hypothesis begins to repeat itself, with variations, after ten."""

PHASES = [Phase.generate, Phase.shrink]
SETTINGS = settings(
    max_examples=PER_BATCH, database=None, deadline=None, phases=PHASES, suppress_health_check=list(HealthCheck)
)


batches = pytest.mark.parametrize("batch", range(FIRST, LAST + 1), scope="module")
"""Of module scope, so that all claims about a batch follow each other and share its runs."""

every_third_batch = pytest.mark.parametrize("batch", range(FIRST, LAST + 1, 3), scope="module")
"""For a claim that takes runs of its own, and longer than all others together."""


def draw_batch(batch: int, claim: Callable[[Drawn], None]) -> None:
    """Check a claim on the mechanisms of a batch, which are the same ones for every claim."""
    seed(batch)(SETTINGS(given(mechanisms())(claim)))()


def random_mechanisms(claim: Callable[[Drawn], None]) -> Callable[[int], None]:
    """Make of a claim about one mechanism a test of many, batch by batch."""

    def test(batch: int) -> None:
        draw_batch(batch, claim)

    test.__name__ = test.__qualname__ = claim.__name__
    return batches(test)


# ---- the start -------------------------------------------------------------------------------------------------------


@random_mechanisms
def test_the_assembled_start_meets_every_joint_and_moves_with_it(drawn: Drawn) -> None:
    # expected: Phi and Phi_q v + Phi_t written by hand are zero
    state, hand = assemble(drawn.mechanism, drawn.start), ByHand(drawn.mechanism)
    q, v = with_ground(state.q), with_ground(state.v)
    np.testing.assert_allclose(hand.phi(q, drawn.start), 0.0, atol=1e-12)
    rate = hand.jacobian(q, drawn.start) @ v[:-3] + hand.phi_t(q, drawn.start)
    np.testing.assert_allclose(rate, 0.0, atol=3e-12)


# ---- the equations ---------------------------------------------------------------------------------------------------


def stage_matrices(workspace: Workspace) -> list[np.ndarray]:
    """Return the parts of the stage matrix with the factors 1, h mu, -h mu and h^2 mu^2, as last evaluated."""
    terms, parts = workspace.terms, np.zeros((4, workspace.unknowns, workspace.unknowns))
    np.add.at(parts, (terms.factor, terms.row, terms.column), workspace.scratch.source[terms.source])
    return list(parts)


def assert_close(found: Any, expected: Any, tolerance: float, size: Any = 0.0) -> None:
    """Assert equality to `tolerance` of the largest number that took part."""
    largest = max(float(np.max(np.abs(x), initial=1.0)) for x in (expected, size))
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * largest)


@random_mechanisms
def test_every_level_of_the_equations_is_the_derivative_of_the_one_below(drawn: Drawn) -> None:
    # expected: complex steps and central differences of order 8 of Phi and of the forces written by hand, at a state
    # that need not meet the joints, between two points of the tables
    hand, t = ByHand(drawn.mechanism), drawn.start + 0.1
    n, q, v = hand.n, hand.q, hand.v
    compiled = compile_mechanism(drawn.mechanism)
    workspace = Workspace(compiled, t, q, v)
    rows = [(row.pair, row.place) for row in compiled.rows]
    a, lam = np.zeros(n + 3), np.zeros((len(compiled.topology.pairs), 2))
    assert workspace.retry_with_new_pivots(lambda: tangents_at(workspace.engine, t, q, v, a, lam)) == 0
    multipliers = np.array([lam[row] for row in rows])

    def along(direction: Any, time: float, at: Any = q) -> Callable[[float], Any]:
        return lambda s: hand.phi((at.T + s * direction.T).T, t + s * time)

    def step(direction: np.ndarray) -> float:
        return 0.004 / max(1.0, float(np.max(np.abs(direction))))

    phi_q = hand.jacobian(q, t)
    gamma = -second_derivative(along(v, 1.0), step(v))
    varied_q, varied_v = steps_along(q, n), steps_along(v, n)
    gamma_q = -derivatives(second_derivative(along(v[:, None], 1.0, varied_q), step(v)))
    gamma_v = -derivatives(second_derivative(along(varied_v, 1.0, q[:, None]), step(v)))
    moved_q = derivatives(first_derivative(along(a[:, None], 0.0, varied_q), step(a)))  # (Phi_q a)_q
    bent = np.zeros((n, n))  # (Phi_q^T lambda)_q: complex steps of Phi beside central differences along each coordinate
    for k in range(n):
        axis = np.eye(n + 3)[k]
        bent[k] = derivatives(first_derivative(along(axis[:, None], 0.0, varied_q), 0.004)).T @ multipliers
    force = hand.forces(q, v, t)
    stiffness = -derivatives(hand.forces(varied_q, v[:, None], t))
    damping = -derivatives(hand.forces(q[:, None], varied_v, t))

    parts = stage_matrices(workspace)
    expected = np.zeros_like(parts)
    expected[0][:n, :n] = np.diag(hand.mass)
    expected[0][n:, :n], expected[0][:n, n:] = phi_q, phi_q.T
    expected[1][:n, :n] = damping
    expected[2][n:, :n] = gamma_v
    expected[3][:n, :n] = bent + stiffness
    expected[3][n:, :n] = moved_q - gamma_q
    assert_close(parts[0], expected[0], 1e-13)
    assert_close(parts[1], expected[1], 1e-12)
    assert_close(parts[2], expected[2], 1e-8)
    assert_close(parts[3][:n], expected[3][:n], 1e-8, multipliers)
    assert_close(parts[3][n:], expected[3][n:], 1e-8, [gamma_q, moved_q])
    assert_close([workspace.scratch.gamma[row] for row in rows], gamma, 1e-9)
    load = np.concatenate([hand.mass * a[:n], force, (phi_q.T * multipliers).ravel()])
    assert_close(hand.mass * a[:n] + phi_q.T @ multipliers, force, 1e-12, load)
    assert_close(phi_q @ a[:n], gamma, 1e-9, phi_q * a[:n])


# ---- the motion ------------------------------------------------------------------------------------------------------

ACCURATE = {"name": "gauss", "stages": 3}

CALM = {"conditioning": 0.05, "spring": 0.15, "acceleration": 100.0}
"""What makes a motion calm: distance from singular positions, lengths of springs [m], accelerations [m/s^2, rad/s^2].

A drawn driver may push a linkage into its dead centre, and a spring be pulled to a point: nothing is promised there.
"""


def run(mechanism: Mechanism, start: float, integrator: dict[str, Any], steps: int) -> Run:
    """Run a mechanism over the longest time, with rows every tenth of it."""
    time = {"start": start, "end": start + LONGEST, "step": LONGEST / steps}
    return mbdkit.run(mechanism, integrator=integrator, time=time, output={"every": steps // 10})


@lru_cache(maxsize=3 * PER_BATCH)
def accurate_run(spec: str, start: float) -> Run:
    """Return the run that the claims about one mechanism share."""
    return run(Mechanism.from_spec(json.loads(spec)), start, ACCURATE, 40)


def states(result: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return recorded positions, velocities and accelerations (T, 3 (B + 1)), ground last and at rest."""
    arrays = (result.array(f"trajectory/{name}") for name in ("position", "velocity", "acceleration"))
    q, v, a = (np.concatenate([x.reshape(len(x), -1), np.zeros((len(x), 3))], axis=1) for x in arrays)
    return q, v, a


def calm_run(drawn: Drawn) -> Run:
    """Return an accurate run; give the example up where its motion is not calm."""
    result = accurate_run(json.dumps(drawn.mechanism.to_spec()), drawn.start)
    hand = ByHand(drawn.mechanism)
    q, _, a = states(result)
    assume(np.max(np.abs(a)) < CALM["acceleration"])
    assume(np.min(hand.spring_lengths(q.T), initial=np.inf) > CALM["spring"])
    assume(min(hand.conditioning(x, t) for x, t in zip(q, result.time, strict=True)) > CALM["conditioning"])
    return result.check()


@random_mechanisms
def test_reactions_and_forces_balance_every_body(drawn: Drawn) -> None:
    # expected: Newton and Euler. A reaction acts on the second body at its joint point, and its opposite on the first
    # body: at that body's own joint point where points coincide, but for drift, and at the second's on a slide or drive
    result, hand = calm_run(drawn), ByHand(drawn.mechanism)
    for row, (q, v, a) in enumerate(zip(*states(result), strict=True)):
        pushes: dict[str, list[tuple[Any, Any]]] = {name: [] for name in hand.number}

        def push(body: str, force: Any, at: Any, torque: float, q: Any = q, pushes: Any = pushes) -> None:
            pushes[body].append((force, cross(at - hand.centre(q, body), force) + torque))

        for force in drawn.mechanism.forces.values():
            for body, vector, point, torque in hand.actions(force, q, v, result.time[row]):
                push(body, vector, hand.point(q, body, point), torque)
        bent = np.zeros_like(q)
        for name, beam in drawn.mechanism.beams.items():
            hand.bend(name, beam, q, v, bent)
        for name in parts_of(drawn.mechanism.beams):
            i = 3 * hand.number[name]
            push(name, bent[i : i + 2], hand.centre(q, name), bent[i + 2])
        for name, joint in drawn.mechanism.joints.items():
            recorded = result.joints[name]
            assert recorded.bodies == joint.bodies
            reaction, torque = recorded.reaction_force[row], recorded.reaction_torque[row]
            points = joint.points or ((0.0, 0.0), (0.0, 0.0))
            here, there = (hand.point(q, body, point) for body, point in zip(joint.bodies, points, strict=True))
            push(joint.bodies[1], reaction, there, torque)
            push(joint.bodies[0], -reaction, here if isinstance(joint, Revolute | Weld) else there, -torque)
        for i, (name, body) in enumerate(drawn.mechanism.bodies.items()):
            push(name, body.mass * np.array(drawn.mechanism.gravity), hand.centre(q, name), 0.0)
            force = sum(force for force, _ in pushes[name])
            torque = sum(torque for _, torque in pushes[name])
            load = max(float(np.max(np.abs(x))) for acting in pushes[name] for x in acting)
            momentum = hand.mass[3 * i : 3 * i + 3] * a[3 * i : 3 * i + 3]
            np.testing.assert_allclose([*force, torque], momentum, rtol=0, atol=1e-10 * max(1.0, load))


@random_mechanisms
def test_results_do_not_depend_on_the_order_in_which_elements_are_written(drawn: Drawn) -> None:
    result = calm_run(drawn)
    other = run(drawn.reordered, drawn.start, ACCURATE, 40).check()

    def agree(found: np.ndarray, expected: np.ndarray) -> None:
        assert_close(found, expected, 1e-10)

    for name in drawn.mechanism.bodies:
        agree(other[name].position, result[name].position)
        agree(other[name].angle, result[name].angle)
        agree(other[name].velocity, result[name].velocity)
        agree(other[name].angular_velocity, result[name].angular_velocity)
    for name in drawn.mechanism.joints:
        agree(other.joints[name].reaction_force, result.joints[name].reaction_force)
        agree(other.joints[name].reaction_torque, result.joints[name].reaction_torque)
    agree(other.energy.total, result.energy.total)


METHODS: tuple[dict[str, Any], ...] = ({"name": "rk4"}, {"name": "gauss", "stages": 2})

CLOSED = 1e-10
"""A balance below this, relative to the energies in play, is left by velocities that meet the joints to 1e-12."""


def imbalance(drawn: Drawn, method: dict[str, Any], steps: int) -> float:
    """Return the largest energy balance of a run, relative to the energies in play."""
    energy = run(drawn.mechanism, drawn.start, method, steps).check().energy
    return float(np.max(np.abs(energy.balance)) / max(1.0, *(np.max(np.abs(x)) for x in (energy.kinetic, energy.work))))


@every_third_batch
def test_the_energy_balance_closes_with_the_order_of_the_method(batch: int) -> None:
    # expected: both methods are of order 4. An error that changes its sign within the run hides the order of a single
    # mechanism, or lets it be seen at smaller steps only; the median over many is close
    orders = []

    def claim(drawn: Drawn) -> None:
        calm_run(drawn)
        for method in METHODS:
            coarse, fine = (imbalance(drawn, method, steps) for steps in (40, 80))
            if fine > CLOSED:
                orders.append(np.log2(coarse / fine))
                assert orders[-1] > 3.0 or np.log2(fine / imbalance(drawn, method, 160)) > 3.0

    draw_batch(batch, claim)
    assert_within(np.median(orders) - 4.0, 0.2)


# ---- to and from a spec ----------------------------------------------------------------------------------------------


def assert_same(found: Mechanism, expected: Mechanism) -> None:
    for part in ("gravity", "bodies", "joints", "forces", "assembly"):
        assert getattr(found, part) == getattr(expected, part)
    assert [list(found.bodies), list(found.joints), list(found.forces)] == [
        list(expected.bodies), list(expected.joints), list(expected.forces),
    ]  # fmt: skip


@random_mechanisms
def test_writing_and_reading_are_inverse(drawn: Drawn) -> None:
    m = drawn.mechanism
    assert_same(Mechanism.from_spec(m.to_spec()), m)
    spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "rk4"}, "time": {"end": 1, "step": 1e-3}}
    spec["time"]["start"] = drawn.start
    spec["time"]["end"] = drawn.start + 0.002
    read = read_yaml(write_yaml(spec))[0]
    assert read == spec
    result = mbdkit.run(read)
    assert_same(load_spec(result.spec).mechanism(), m)
    with TemporaryDirectory() as folder:
        result.save(Path(folder) / "saved.h5")
        with mbdkit.load(Path(folder) / "saved.h5") as loaded:
            assert_same(load_spec(loaded.spec).mechanism(), m)
            assert list(loaded.bodies) == list(m.bodies)
            assert list(loaded.joints) == list(m.joints)
            for path in ("trajectory/position", "joints/reaction_force", "energy/balance"):
                np.testing.assert_array_equal(loaded.array(path), result.array(path))
