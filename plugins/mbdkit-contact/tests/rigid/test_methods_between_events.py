"""Event-driven contacts with methods of all kinds, against SciPy's DOP853 in minimal coordinates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.rigid.scenes import FLOOR, G, outline, run

import mbdkit
from tests.margins import assert_within

RESTITUTION, FRICTION = 0.5, 0.3
END, STEP = 0.7, 0.01
METHODS: dict[str, tuple[dict[str, Any], float]] = {
    "dop853": ({"name": "dop853"}, 1e-9),
    "dop853 adaptive": ({"name": "dop853", "adaptive": True, "rtol": 1e-10}, 1e-8),
    "dopri5 adaptive": ({"name": "dopri5", "adaptive": True, "rtol": 1e-9}, 1e-7),
    "gauss": ({"name": "gauss", "stages": 3}, 1e-8),
    "gauss adaptive": ({"name": "gauss", "stages": 3, "adaptive": True, "rtol": 1e-8}, 1e-6),
    "radau-iia": ({"name": "radau-iia", "stages": 3}, 1e-7),
    "radau-iia adaptive": ({"name": "radau-iia", "stages": 3, "adaptive": True, "rtol": 1e-8}, 1e-6),
    "scipy-radau": ({"name": "scipy-radau", "rtol": 1e-9}, 1e-6),
    "scipy-dop853": ({"name": "scipy-dop853", "rtol": 1e-10}, 1e-6),
    "scipy-lsoda": ({"name": "scipy-lsoda", "rtol": 1e-10}, 1e-6),
}
"""Options of each method, and the largest error of the end [m, m/s], from its order or its tolerance."""


def spec(integrator: dict[str, Any], **sections: Any) -> dict[str, Any]:
    """Return a ball that a force by a first-order state moves, and a block that a spring pulls over a floor."""
    model = {
        "name": "mechanism",
        "bodies": {
            "ball": {"mass": 1.0, "position": [0.0, 0.6]},
            "block": {"mass": 2.0, "inertia": 0.1, "position": [1.0, 0.1], "velocity": [1.5, 0.0]},
        },
        "forces": {
            "push": {"type": "force", "body": "ball", "point": [0, 0], "value": [0.0, "states.x"]},
            "pull": {
                "type": "spring-damper", "bodies": ["ground", "block"], "points": [[0.2, 0.1], [0, 0]],
                "stiffness": 90.0, "damping": 0.0, "free_length": 0.7,
            },
        },
        "states": {"x": {"initial": 0.5, "rate": "-3*states.x + 2*cos(9*t)"}},
        "contacts": {
            "bounce": {"bodies": ["ground", "ball"], "shapes": [FLOOR, {"point": [0, 0]}], "restitution": RESTITUTION},
            "slide": {"bodies": ["ground", "block"], "shapes": [FLOOR, BOX], "friction": FRICTION},
        },
    }  # fmt: skip
    time = {"end": END, "step": STEP}
    return {"mbdkit": 1, "model": model, "integrator": integrator, "time": time} | {
        "contact": {"treatment": "event-driven"}, **sections,
    }  # fmt: skip


BOX = outline(0.3, 0.1)
TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}


def ball_at_end() -> tuple[np.ndarray, list[float]]:
    """Return height, velocity and state of the ball at the end, and the times of its impacts."""

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], y[2] - G, -3.0 * y[2] + 2.0 * math.cos(9.0 * t)]

    def touches(t: float, y: np.ndarray) -> float:
        return float(y[0])

    touches.terminal, touches.direction = True, -1.0  # type: ignore[attr-defined]
    t, y, impacts = 0.0, np.array([0.6, 0.0, 0.5]), []
    while True:
        part = solve_ivp(rates, (t, END), y, events=touches, **TIGHT)
        t, y = float(part.t[-1]), part.y[:, -1].copy()
        if part.status != 1:
            return y, impacts
        impacts.append(t)
        y[:2] = 0.0, -RESTITUTION * y[1]


def block_at_end() -> np.ndarray:
    """Return position and velocity of the block, whose slip ends and begins anew at rest."""
    t, y = 0.0, np.array([1.0, 1.5])
    while t < END:
        pull = -90.0 * (y[0] - 0.2 - 0.7)
        if abs(y[1]) < 1e-12 and abs(pull) <= FRICTION * 2.0 * G:
            return np.array([y[0], 0.0])  # it sticks from now on, because the spring does not change
        way = math.copysign(1.0, y[1] if abs(y[1]) >= 1e-12 else pull)

        def rates(t: float, y: np.ndarray, way: float = way) -> list[float]:
            return [y[1], -45.0 * (y[0] - 0.9) - way * FRICTION * G]

        def stops(t: float, y: np.ndarray, begin: float = t, way: float = way) -> float:
            return way * float(y[1]) if t > begin + 1e-6 else 1.0

        stops.terminal = True  # type: ignore[attr-defined]
        part = solve_ivp(rates, (t, END), y, events=stops, **TIGHT)
        t, y = float(part.t[-1]), part.y[:, -1].copy()
        if part.status == 1:
            y[1] = 0.0
    return y


@pytest.mark.parametrize("name", METHODS)
def test_a_ball_with_a_state_and_a_sliding_block_move_as_by_scipy(name: str) -> None:
    integrator, bound = METHODS[name]
    ball, impacts = ball_at_end()
    block = block_at_end()
    found = mbdkit.run(spec(integrator)).check()
    ends = [found["ball"].position[-1, 1], found["ball"].velocity[-1, 1], found.states["x"].value[-1]]
    np.testing.assert_allclose(ends, ball, rtol=0, atol=bound)
    ends = [found["block"].position[-1, 0], found["block"].velocity[-1, 0]]
    np.testing.assert_allclose(ends, block, rtol=0, atol=bound)
    struck = found.impacts.time[(found.impacts.contact == "bounce") & (found.impacts.normal_impulse > 0)]
    np.testing.assert_allclose(struck, impacts, rtol=0, atol=bound)
    assert_within(found.energy.balance, 100 * bound)  # friction, impacts and the force are booked


@pytest.mark.parametrize("restitution", [0.0, 1.0])
def test_an_impact_within_rounding_errors_of_the_end_of_a_step_happens_once(restitution: float) -> None:
    # expected: uniform motion until 100 s, which is the end of a step
    speed = 0.9
    bodies = {"b": {"mass": 1.0, "position": [0.0, 100.0 * speed], "velocity": [0.0, -speed]}}
    contact = {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0, 0]}], "restitution": restitution}
    model = {"gravity": [0, 0], "bodies": bodies, "contacts": {"floor": contact}}
    found = run(model, 100.2, 0.01, method="rk4", output={"every": 100}).check()
    assert found.impacts.time == pytest.approx([100.0], abs=1e-11)
    assert found["b"].velocity[-1, 1] == pytest.approx(restitution * speed)


def test_a_run_that_stops_at_an_impact_ends_before_it() -> None:
    # expected: the velocity sqrt(2 g h) of the fall, before the impact
    bodies = {"b": {"mass": 1.0, "position": [0.0, 1.0]}}
    contact = {"bodies": ["ground", "b"], "shapes": [FLOOR, {"point": [0, 0]}], "restitution": 0.5}
    model = {"bodies": bodies, "contacts": {"floor": contact}}
    events = {"up": {"when": "b.vy", "direction": "rising", "action": "stop"}}
    for name in ("dopri5", "rk4"):
        found = run(model, 1.0, 0.01, method=name, events=events)
        assert found.time[-1] == pytest.approx(math.sqrt(2.0 / G), abs=1e-9)
        assert found["b"].velocity[-1, 1] == pytest.approx(-math.sqrt(2.0 * G), rel=1e-9)
        assert len(found.impacts.time) == 1


def test_errors_of_implicit_methods_with_contacts_decrease_with_their_order() -> None:
    # expected: order 4 of the velocity of a ball, whose force is a smooth state, behind an impact
    exact = ball_at_end()[0]
    errors = []
    for step in (0.04, 0.02):
        found = mbdkit.run(spec({"name": "gauss", "stages": 2}, time={"end": END, "step": step})).check()
        errors.append(abs(found.states["x"].value[-1] - exact[2]))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)  # margin: order, from errors of mbdkit alone


@pytest.mark.parametrize("method", [{"name": "radau-iia", "stages": 2}, {"name": "gauss", "stages": 2}])
def test_stiff_forces_on_a_sticking_block_take_few_iterations(method: dict[str, Any]) -> None:
    # expected: the spring is so stiff that the load follows its force; friction holds the block against it
    stiffness = 1e7  # N/m, for steps of 30 periods of the spring
    bodies = {
        "block": {"mass": 2.0, "inertia": 0.1, "position": [0.0, 0.1]},
        "load": {"mass": 1.0, "inertia": 0.1, "position": [1.0, 0.1]},
    }
    model = {
        "name": "mechanism",
        "bodies": bodies,
        "joints": {
            "rail": {"type": "prismatic", "bodies": ["ground", "load"], "points": [[0, 0.1], [0, 0]], "axis": [1, 0]}
        },
        "forces": {
            "spring": {
                "type": "spring-damper", "bodies": ["block", "load"], "points": [[0, 0], [0, 0]],
                "stiffness": stiffness, "damping": 2e3, "free_length": 1.0,
            },
            "push": {"type": "force", "body": "load", "point": [0, 0], "value": ["5*sin(2*t)", 0]},
        },
        "contacts": {"floor": {"bodies": ["ground", "block"], "shapes": [FLOOR, BOX], "friction": 0.9}},
    }  # fmt: skip
    found = run(model, 1.0, 0.05, method=method).check()
    friction = sum(found.contacts[f"floor.{i}"].friction_force for i in range(4))
    np.testing.assert_allclose(np.abs(friction[-5:]), np.abs(5.0 * np.sin(2.0 * found.time[-5:])), rtol=2e-3)
    assert found.stats["newton_iterations"] < 10 * found.stats["steps"]


def test_errors_of_a_controlled_run_are_estimated_by_runs_with_other_methods() -> None:
    # expected: the bars hold the differences from SciPy
    found = mbdkit.run(spec({"name": "dopri5", "adaptive": True, "rtol": 1e-5}, check=True, time={"end": 0.3})).check()
    tight = mbdkit.run(spec({"name": "dop853", "adaptive": True, "rtol": 1e-12}, time={"end": 0.3})).check()
    error = np.abs(found["ball"].position[-1] - tight["ball"].position[-1])
    assert found.accuracy is not None
    assert found.accuracy.known_until == pytest.approx(0.3)
    assert np.all(error <= 2.0 * found.accuracy.position_error[-1, 0, :2] + 1e-12)


@pytest.mark.parametrize(
    ("integrator", "sections", "why"),
    [
        ("moreau-jean", {}, "the integrator moreau-jean does not locate impacts; use the treatment time-stepping"),
        ("rattle", {"formulation": "index-3"}, "cannot use rattle, whose steps exist in machine code only"),
        ("taylor", {"formulation": "joint-coordinates"}, "cannot use taylor, whose steps exist in machine code only"),
        ("radau-iia", {"formulation": "index-3"}, "solves the index-1 equations with Runge-Kutta methods; omit"),
    ],
)
def test_other_methods_are_refused_before_the_first_step(integrator: str, sections: dict[str, Any], why: str) -> None:
    with pytest.raises(mbdkit.SpecError, match=why):
        mbdkit.run(spec({"name": integrator}, **sections))
