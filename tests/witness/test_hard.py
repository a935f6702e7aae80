"""Hard mechanisms: each agrees with a reference, or stops with the right reason; no recorded value is NaN."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.witness.hard_runs import EXPLICIT, METHODS, every_method, run

from . import ode
from .hung_chain import HungChain
from .pendulum import Pendulum

IMPLICIT = ("gauss-1", "gauss-2", "gauss-3", "radau-iia-2", "radau-iia-3", "radau-iia-5")


Array = NDArray[np.floating[Any]]


def welded() -> dict[str, Any]:
    """Return two uniform rods of 1 m and 1 kg in a row, held together by a pin and by a weld on top of it."""
    bodies = {f"rod{k}": {"mass": 1.0, "inertia": 1 / 12, "position": [k - 0.5, 0.0], "angle": 0.0} for k in (1, 2)}
    ends = {"bodies": ["rod1", "rod2"], "points": [[0.5, 0], [-0.5, 0]]}
    joints = {
        "A": {"type": "revolute", "bodies": ["ground", "rod1"], "points": [[0, 0], [-0.5, 0]]},
        "pin": {"type": "revolute", **ends},
        "weld": {"type": "weld", **ends},
    }
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


@every_method
def test_weld_on_top_of_a_pin_makes_two_rods_one(method):
    # expected: the pendulum of a rod of 2 m in closed form
    result = run(welded(), method).check()
    assert result.redundancy.startswith("2 redundant rows: joint")
    expected = Pendulum.rod(length=2.0, mass=2.0).motion([1.0])[0][0]
    for name in ("rod1", "rod2"):
        assert result[name].angle[-1] == pytest.approx(expected, abs=METHODS[method][2])


def cart(mass: float) -> dict[str, Any]:
    """Return a cart on a rail under a pole of 1 m and 1 kg that leans over."""
    bodies = {
        "cart": {"mass": mass, "inertia": mass, "position": [0.0, 0.0]},
        "pole": {"mass": 1.0, "inertia": 1 / 12, "position": [0.5 * math.cos(1.2), 0.5 * math.sin(1.2)], "angle": 1.2},
    }
    joints = {
        "rail": {"type": "prismatic", "bodies": ["ground", "cart"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
        "pin": {"type": "revolute", "bodies": ["cart", "pole"], "points": [[0, 0], [-0.5, 0]]},
    }
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


@every_method
@pytest.mark.parametrize("mass", [1e-6, 1e6])
def test_pole_on_a_cart_a_million_times_lighter_or_heavier_falls_as_in_two_coordinates(method, mass):
    place, angle = cart_and_pole(mass)
    result = run(cart(mass), method).check()
    assert result["pole"].angle[-1] == pytest.approx(angle, abs=METHODS[method][2] * 3)
    assert result["cart"].position[-1, 0] == pytest.approx(place, abs=METHODS[method][2] * 3)


@cache
def cart_and_pole(mass: float) -> tuple[float, float]:
    """Return the place of a cart and the angle of its pole after a second.

    By Lagrange's equations in the cart's way and the pole's angle, and DOP853.
    """

    def right_side(time: Any, y: Array) -> Array:
        _, angle, speed, rate = y
        c, s = math.cos(angle), math.sin(angle)
        matrix = np.array([[mass + 1.0, -0.5 * s], [-0.5 * s, 1 / 3]])
        return np.array([speed, rate, *np.linalg.solve(matrix, [0.5 * c * rate**2, -9.81 * 0.5 * c])])

    place, angle, _, _ = ode.dop853(right_side, np.array([0.0, 1.2, 0.0, 0.0]), np.array([1.0]))[-1]
    return float(place), float(angle)


TEN = HungChain(tuple(1 + 0.1 * k for k in range(10)), tuple(-1.1 + 2.2 * (k + 0.5) / 10 for k in range(10)))


@pytest.fixture(scope="module")
def ten_rods() -> Array:
    """Return the angles of the ten rods after half a second."""
    return TEN.solve(np.array([0.5]))[-1]


@every_method
def test_loop_of_ten_rods_sways_as_in_its_angles(method, ten_rods):
    # expected: Lagrange's equations of the first kind in ten angles, by DOP853
    result = run(TEN.model(), method, end=0.5).check()
    found = [result[f"rod{k + 1}"].angle[-1] for k in range(10)]
    np.testing.assert_allclose(found, ten_rods, rtol=0, atol=10 * METHODS[method][2])


def on_springs(stiffness: float, damping: float) -> dict[str, Any]:
    """Return a rod of 1 m and 1 kg on a hub of 0.1 kg that two spring-dampers hold in place."""
    bodies = {"hub": {"mass": 0.1}, "rod": {"mass": 1.0, "inertia": 1 / 12, "position": [0.5, 0.0]}}
    joints = {"pin": {"type": "revolute", "bodies": ["hub", "rod"], "points": [[0, 0], [-0.5, 0]]}}
    forces = {
        name: {
            "type": "spring-damper",
            "bodies": ["ground", "hub"],
            "points": [point, [0, 0]],
            "stiffness": stiffness,
            "damping": damping,
            "free_length": 1.0,
        }
        for name, point in (("level", [-1, 0]), ("upright", [0, 1]))
    }
    return {"name": "mechanism", "bodies": bodies, "joints": joints, "forces": forces}


@pytest.mark.parametrize("method", [name for name in IMPLICIT if name != "gauss-1"])
def test_rod_on_springs_of_a_hundred_meganewtons_a_metre_swings_as_if_on_a_pin(method):
    # expected: the pendulum in closed form; a force of 20 N stretches the springs by 2e-7 m
    step = 1e-3 if method.endswith("2") else 5e-3
    result = run(on_springs(1e8, 1e4), method, step=step).check()
    expected = Pendulum.rod().motion([1.0])[0][0]
    assert result["rod"].angle[-1] == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize("method", EXPLICIT)
def test_explicit_methods_fail_on_stiff_springs_and_name_what_may_help(method):
    # expected: h |lambda| = 1e-3 * 1e5 is far outside any explicit method's stability region
    result = run(on_springs(1e8, 1e4), method, step=1e-3)
    assert result.status == "failed"
    assert result.status_reason.startswith(("fell-apart: ", "not-finite: numbers overflowed in step "))
    assert "an implicit method" in result.status_reason or "implicit integrator may help" in result.status_reason
    assert result.time[-1] < 0.2


def test_adaptive_explicit_solver_spends_its_steps_on_stiff_springs_and_says_so():
    # expected: stability holds the step near 6 / 1e5 s, whatever the tolerance
    result = run(on_springs(1e8, 1e4), "scipy-dop853", limits={"max_steps": 500})
    assert result.status_reason.startswith("max-steps: ")
    assert result.time[-1] < 0.1


def twice_driven(second: str) -> dict[str, Any]:
    """Return a rod on a pin with two drivers of its angle."""
    bodies = {"rod": {"mass": 1.0, "inertia": 1 / 12, "position": [0.5, 0.0], "angular_velocity": 1.0}}
    joints = {
        "A": {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0, 0], [-0.5, 0]]},
        "M": {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angle", "motion": "t"},
        "N": {"type": "driver", "bodies": ["ground", "rod"], "coordinate": "angle", "motion": second},
    }
    return {"name": "mechanism", "bodies": bodies, "joints": joints}


@every_method
def test_drivers_that_agree_at_the_start_and_part_later_stop_the_run_by_name(method):
    # expected: the motions differ by 1e-2 max(0, t - 0.5)^4, which passes 1e-6 rad at 0.6 s
    result = run(twice_driven("t + 0.01*max(0, t - 0.5)**4"), method)
    code, _, sentence = result.status_reason.partition(": ")
    assert (result.status, code) == ("failed", "singular")
    assert "joint 'N'" in sentence
    assert "as M" in sentence
    assert 0.3 < result.time[-1] < 0.9


@every_method
def test_drivers_that_agree_for_good_run_to_the_end(method):
    result = run(twice_driven("sin(t)*sin(t) + t + cos(t)**2 - 1"), method).check()
    assert result["rod"].angle[-1] == pytest.approx(1.0, abs=1e-6)
    assert result.redundancy == "1 redundant row: drivers M and N"
