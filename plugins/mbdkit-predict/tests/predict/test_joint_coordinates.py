"""Joint coordinates: equations of motion and quantities against the machine code of runs; the same optima."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit.engine.equations_of_motion import EquationsOfMotion
from mbdkit.spec import load_spec
from mbdkit_predict.casadi_system import CasadiSystem
from mbdkit_predict.chosen_numbers import ChosenNumbers
from predict.exact_optima import swing_up
from tests.engine import random_mechanisms
from tests.engine.strategies import Drawn, mechanisms
from tests.margins import assert_within

CLOSE = 1e-9
"""Largest difference, relative to the largest number of a result."""


def close(found: Any, wanted: Any, least: float = 1.0) -> None:
    wanted = np.asarray(wanted)
    size = np.max(np.abs(wanted), initial=least)
    np.testing.assert_allclose(np.array(found).reshape(wanted.shape), wanted, rtol=0.0, atol=CLOSE * size)


def check(m: Mechanism, t: float = 0.0) -> None:
    m.is_of_run = True
    wanted, chosen = EquationsOfMotion.of(m, t), ChosenNumbers(m, [], [])
    system, whole = CasadiSystem(chosen, t, is_joint=True), CasadiSystem(chosen, t)
    if len(system.q0) == len(whole.q0):
        return  # no joint of a tree, or friction
    names = wanted.constraint_names
    cut = np.array([name in system.constraint_names for name in names], dtype=bool)
    turn = system.function(
        "turn", {"turn": ca.jacobian(system.placed(*(system.symbols[x] for x in "qvapt"))[1], system.v)}
    )
    rng, n = np.random.default_rng(0), len(system.q0)
    wanted.hold(wanted.z0)
    for spread in (0.0, 0.3):
        y, rates, acc = (start + spread * rng.normal(size=n) for start in (system.q0, system.v0, 0.0))
        lam = rng.normal(size=int(cut.sum()))
        q, v, a = (np.array(x).ravel() for x in system.placed(y, rates, acc, [], t))
        own = (y, rates, acc, lam, wanted.z0, [], [], t)
        T = np.array(turn(*own))
        # the joints of the tree are closed, and do no work on its motions
        jacobian = wanted.constraint_jacobian(t, q).toarray()
        close(wanted.constraints(t, q)[~cut], 0.0 * wanted.constraints(t, q)[~cut])
        kept = int((~cut).sum())
        close(wanted.constraint_rates(t, q, v)[~cut], np.zeros(kept), float(np.abs(v).max()))
        close((jacobian @ a - wanted.gamma(t, q, v))[~cut], np.zeros(kept), float(np.abs(a).max()) + 1.0)
        close((jacobian @ T)[~cut], np.zeros((kept, n)))
        every = np.zeros(len(names))
        every[cut] = lam
        close(system.residual(*own), T.T @ wanted.residual(t, q, v, a, every))
        rows = wanted.constraints(t, q), wanted.constraint_rates(t, q, v), jacobian @ a - wanted.gamma(t, q, v)
        for found, row in zip(system.constraints(*own), rows, strict=True):
            close(found, row[cut], float(np.abs(a).max()) + 1.0)
        for name, x in zip("qva", system.taken(q, v, a, [], t), strict=True):
            close(x, {"q": y, "v": rates, "a": acc}[name], float(np.abs(a).max()) + 1.0)
    # at a motion, the multipliers of the tree follow: quantities are those of absolute coordinates
    q, v = wanted.q0, wanted.v0
    a, lam, _ = wanted.derivatives(t, q, v, wanted.z0)
    y, rates, acc = system.taken(q, v, a, [], t)
    close(
        system.residual(y, rates, acc, lam[cut], wanted.z0, [], [], t), np.zeros(n), float(np.abs(lam).max(initial=1.0))
    )
    assert system.quantity_names == whole.quantity_names
    found = system.quantities(y, rates, acc, lam[cut], wanted.z0, [], [], t)
    close(found, whole.quantities(q, v, a, lam, wanted.z0, [], [], t))


@pytest.mark.parametrize("count", [3, pytest.param(200, marks=pytest.mark.slow)])
def test_random_mechanisms_are_those_of_the_machine_code(count: int) -> None:
    @settings(max_examples=count, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
    @given(mechanisms())
    def compare(drawn: Drawn) -> None:
        with contextlib.suppress(SpecError):  # no consistent start
            EquationsOfMotion.of(drawn.mechanism, drawn.start)
            check(drawn.mechanism, drawn.start)

    compare()


GENERATORS: list[Callable[..., Mechanism]] = [
    random_mechanisms.chain, random_mechanisms.tree, random_mechanisms.loop, random_mechanisms.ladder,
    random_mechanisms.driven_frame, random_mechanisms.slides,
]  # fmt: skip


@pytest.mark.parametrize("generator", GENERATORS)
def test_chains_loops_and_slides_are_those_of_the_machine_code(generator: Callable[..., Mechanism]) -> None:
    check(generator(np.random.default_rng(1)))


@pytest.mark.parametrize(
    "name", ["quick-return", "series-elastic-knee", "sit-down", "knee", "light-cart-pole", "particle-four-bar"]
)
def test_examples_are_those_of_the_machine_code(name: str) -> None:
    check(load_spec(name).mechanism())


def bobs() -> Mechanism:
    """Two point masses below a rod that turns, one of which bears the other; and two that fly, joined by a rod."""
    m = Mechanism()
    rod = m.body("rod", mass=2.0, inertia=0.3, position=(0.4, 0.1), angle=0.2, angular_velocity=1.5)
    m.revolute("pin", m.ground, rod, at=(0.0, 0.0))
    lower = m.body("lower", mass=0.5, position=(1.1, -0.7), velocity=(0.4, 0.1))
    upper = m.body("upper", mass=0.7, position=(0.8, -0.3))
    m.distance("short", upper, rod, **{"from": (0.8, -0.3), "to": (0.7, 0.1)})
    m.distance("long", upper, lower, **{"from": (0.8, -0.3), "to": (1.1, -0.7)})
    first = m.body("first", mass=0.2, position=(2.0, 1.0))
    second = m.body("second", mass=0.3, position=(2.5, 1.2))
    m.distance("flying", first, second, **{"from": (2.0, 1.0), "to": (2.5, 1.2)})
    m.spring_damper("spring", second, lower, stiffness=20.0, damping=0.3, free_length=1.0, points=[(0, 0), (0, 0)])
    return m


def test_a_point_mass_at_a_distance_has_the_angle_of_its_arm() -> None:
    check(m := bobs())
    system = CasadiSystem(ChosenNumbers(m, [], []), 0.0, is_joint=True)
    assert system.constraint_names == ()
    assert system.is_arm.sum() == 3


def test_a_cart_with_a_point_mass_swings_up_as_one_with_a_pole(tmp_path: Path) -> None:
    (tmp_path / "cart.yaml").write_text(POINT_MASS)
    run = mbdkit.predict(tmp_path / "cart.yaml")
    assert run.verdict == "good", run.verdict_reasons
    assert_within(run.objective - swing_up(5, 80), run.objective_error)


POINT_MASS = """
mbdkit_predict: 1
base:
  model:
    name: mechanism
    bodies: {cart: {mass: 1.0, position: [0, 0]}, bob: {mass: 0.3, position: [0, -0.5]}}
    joints:
      rail: {type: driver, bodies: [ground, cart], coordinate: y, motion: 0.0}
      rod: {type: distance, bodies: [cart, bob], points: [[0, 0], [0, 0]], length: 0.5}
    forces: {push: {type: force, body: cart, value: [0.0, 0.0]}}
controls: {"forces.push.value[0]": {bounds: [-20, 20], start: -2}}
duration: 2.0
initial: {cart.x: 0, cart.vx: 0, bob.x: 0, bob.y: -0.5, bob.vx: 0, bob.vy: 0}
final: {cart.x: 1, cart.vx: 0, bob.x: 1, bob.y: 0.5, bob.vx: 0}
subject_to: {track: {value: cart.x, min: -2, max: 2}}
minimize: integral(forces.push.value**2)
"""


@pytest.mark.parametrize("coordinates", ["joint", "absolute"])
def test_both_coordinates_have_the_optimum_of_another_transcription(coordinates: str) -> None:
    run = mbdkit.predict("cart-pole", coordinates=coordinates)
    assert run.verdict == "good"
    assert_within(run.objective - swing_up(5, 80), run.objective_error)


@pytest.mark.slow
def test_reactions_of_both_coordinates_are_equal() -> None:
    runs = [mbdkit.predict("assisted-squat", coordinates=x, compare={}) for x in ("joint", "absolute")]
    assert_within(runs[0].objective - runs[1].objective, sum(run.objective_error for run in runs))
    at = np.linspace(0.0, 1.2, 50)
    forces = [np.interp(at, run.time, run.joints["knee"].reaction_force[:, 0]) for run in runs]
    np.testing.assert_allclose(forces[0], forces[1], atol=0.01 * np.abs(forces[1]).max())


def test_friction_in_joints_takes_absolute_coordinates() -> None:
    m = Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    m.revolute("hip", m.ground, rod, at=(0, 0), friction={"coefficient": 0.1, "radius": 0.01})
    assert len(CasadiSystem(ChosenNumbers(m, [], []), 0.0, is_joint=True).q0) == 3
