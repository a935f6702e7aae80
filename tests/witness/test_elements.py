"""Single elements against closed forms and plain differential equations: drivers, springs and dampers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import ode
from .problems import DRIVEN_PENDULUM
from .running import gauss, run

G = 9.81


def rod(
    angle: float, velocity: tuple[float, float] = (0.0, 0.0), rate: float = 0.0, pin: float = 0.0
) -> dict[str, Any]:
    """Return a uniform rod of 1 m and 1 kg whose inner end is at (pin, 0)."""
    return {
        "mass": 1.0,
        "inertia": 1.0 / 12.0,
        "position": [pin + 0.5 * math.cos(angle), 0.5 * math.sin(angle)],
        "angle": angle,
        "velocity": list(velocity),
        "angular_velocity": rate,
    }


PIN = {"type": "revolute", "bodies": ["ground", "rod"], "points": [[0.0, 0.0], [-0.5, 0.0]]}


def test_a_driven_rod_has_the_torque_pin_force_and_work_of_its_prescribed_motion() -> None:
    # expected: closed form; I theta'' = torque - m g L/2 cos(theta), and the work is the change of energy
    angle, rate = 0.3, 0.8 * 2.0
    model = {
        "name": "mechanism",
        "bodies": {"rod": rod(angle, (-0.5 * math.sin(angle) * rate, 0.5 * math.cos(angle) * rate), rate)},
        "joints": {
            "pin": PIN,
            "motor": {
                "type": "driver",
                "bodies": ["ground", "rod"],
                "coordinate": "angle",
                "motion": "0.3 + 0.8*sin(2*t)",
            },
        },
    }
    result = run(model, gauss(4), end=3.0, step=0.01, every=5)
    t = np.asarray(result.time)
    theta, omega, alpha = 0.3 + 0.8 * np.sin(2 * t), 1.6 * np.cos(2 * t), -3.2 * np.sin(2 * t)
    np.testing.assert_allclose(result["rod"].angle, theta, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result["rod"].angular_velocity, omega, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.joints["motor"].reaction_torque, alpha / 3 + G / 2 * np.cos(theta), atol=1e-10)
    along = -0.5 * omega[:, None] ** 2 * np.column_stack([np.cos(theta), np.sin(theta)])
    across = 0.5 * alpha[:, None] * np.column_stack([-np.sin(theta), np.cos(theta)])
    np.testing.assert_allclose(result.joints["pin"].reaction_force, along + across + [0.0, G], rtol=0, atol=1e-10)
    energy = omega**2 / 6 + G / 2 * np.sin(theta)
    np.testing.assert_allclose(result.energy.work, energy - energy[0], rtol=0, atol=1e-10)


def test_a_driver_in_a_chain_has_the_torque_of_the_inverse_dynamics() -> None:
    # expected: Lagrange's equation of the driven angle, evaluated on the DOP853 solution for the other angle
    result = run(DRIVEN_PENDULUM.model(), gauss(4), end=2.0, step=0.01, every=10)
    solution = DRIVEN_PENDULUM.solve(np.linspace(0.0, 2.0, 21))
    np.testing.assert_allclose(result["rod2"].angle, solution[:, 1], rtol=0, atol=1e-11)
    np.testing.assert_allclose(result.joints["motor"].reaction_torque, solution[:, 6], rtol=0, atol=1e-9)


def test_a_rod_on_a_shaken_pin_follows_its_equation_of_motion() -> None:
    # expected: (J + m a^2) theta'' = m a (X'' sin(theta) - (g + Y'') cos(theta)) by DOP853 at rtol 1e-13
    def right_side(time: Any, state: Any) -> Any:
        push = -0.3 * 9.0 * np.sin(3 * time)
        lift = -0.2 * 25.0 * np.cos(5 * time)
        acceleration = 1.5 * (push * np.sin(state[0]) - (G + lift) * np.cos(state[0]))
        return np.array([state[1], acceleration])

    model = {
        "name": "mechanism",
        "bodies": {"rod": rod(-0.4, velocity=(0.9, 0.0))},
        "joints": {
            name: {
                "type": "driver",
                "bodies": ["ground", "rod"],
                "coordinate": name,
                "motion": motion,
                "points": [[0.0, 0.0], [-0.5, 0.0]],
            }
            for name, motion in (("x", "0.3*sin(3*t)"), ("y", "0.2*cos(5*t) - 0.2"))
        },
    }
    result = run(model, gauss(4), end=2.0, step=0.005, every=20)
    t = np.asarray(result.time)
    solution = ode.dop853(right_side, np.array([-0.4, 0.0]), t)
    np.testing.assert_allclose(result["rod"].angle, solution[:, 0], rtol=0, atol=1e-10)
    pin = np.column_stack([0.3 * np.sin(3 * t), 0.2 * np.cos(5 * t) - 0.2])
    centre = pin + 0.5 * np.column_stack([np.cos(solution[:, 0]), np.sin(solution[:, 0])])
    np.testing.assert_allclose(result["rod"].position, centre, rtol=0, atol=1e-10)


def test_a_slider_driven_in_a_turning_frame_goes_round_as_prescribed() -> None:
    # expected: closed form; the point mass sits at (1 + 0.1 sin(2 t), 0.2) of a frame that turns by 1.5 t
    turntable = {"mass": 2.0, "inertia": 0.5, "position": [0.0, 0.0], "angular_velocity": 1.5}
    pair = ["table", "mass"]
    model = {
        "name": "mechanism",
        "gravity": [0.0, 0.0],
        "bodies": {"table": turntable, "mass": {"mass": 0.3, "position": [1.0, 0.2], "velocity": [-0.1, 1.5]}},
        "joints": {
            "axle": {"type": "revolute", "bodies": ["ground", "table"], "points": [[0.0, 0.0], [0.0, 0.0]]},
            "motor": {"type": "driver", "bodies": ["ground", "table"], "coordinate": "angle", "motion": "1.5*t"},
            "along": {"type": "driver", "bodies": pair, "coordinate": "x", "motion": "1 + 0.1*sin(2*t)"},
            "across": {"type": "driver", "bodies": pair, "coordinate": "y", "motion": 0.2},
        },
    }
    result = run(model, gauss(4), end=3.0, step=0.01, every=10)
    t = np.asarray(result.time)
    place = (1 + 0.1 * np.sin(2 * t) + 0.2j) * np.exp(1.5j * t)
    np.testing.assert_allclose(result["mass"].position, np.column_stack([place.real, place.imag]), rtol=0, atol=1e-11)
    # Newton's law in the turning frame: z'' = (w'' + 2 i 1.5 w' - 1.5^2 w) exp(1.5 i t)
    w, dw, ddw = 1 + 0.1 * np.sin(2 * t) + 0.2j, 0.2 * np.cos(2 * t), -0.4 * np.sin(2 * t)
    force = 0.3 * (ddw + 3j * dw - 2.25 * w) * np.exp(1.5j * t)
    seen = np.asarray(result.joints["along"].reaction_force) + np.asarray(result.joints["across"].reaction_force)
    np.testing.assert_allclose(seen, np.column_stack([force.real, force.imag]), rtol=0, atol=1e-9)
    # moment of momentum about the axle: the motor's torque is that of the force on the mass
    moment = np.imag(np.conj(place) * force)
    np.testing.assert_allclose(result.joints["motor"].reaction_torque, moment, rtol=0, atol=1e-9)


def test_a_mass_on_a_spring_damper_follows_its_equation_of_motion() -> None:
    # expected: m r'' = m g - (k (l - l0) + c l') r / l by DOP853 at rtol 1e-13, with the dissipated energy
    mass, stiffness, damping, free = 0.7, 60.0, 0.4, 0.6

    def right_side(time: Any, state: Any) -> Any:
        length = np.hypot(state[0], state[1])
        speed = (state[0] * state[2] + state[1] * state[3]) / length
        pull = (stiffness * (length - free) + damping * speed) / length / mass
        return np.array([state[2], state[3], -pull * state[0], -pull * state[1] - G, damping * speed**2])

    model = {
        "name": "mechanism",
        "bodies": {"bob": {"mass": mass, "position": [0.8, 0.1], "velocity": [0.0, -0.5]}},
        "forces": {
            "spring": {
                "type": "spring-damper",
                "bodies": ["ground", "bob"],
                "points": [[0.0, 0.0], [0.0, 0.0]],
                "stiffness": stiffness,
                "damping": damping,
                "free_length": free,
            }
        },
    }
    result = run(model, gauss(4), end=3.0, step=0.01, every=10)
    solution = ode.dop853(right_side, np.array([0.8, 0.1, 0.0, -0.5, 0.0]), np.asarray(result.time))
    np.testing.assert_allclose(result["bob"].position, solution[:, :2], rtol=0, atol=1e-10)
    np.testing.assert_allclose(result["bob"].velocity, solution[:, 2:4], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.energy.dissipated, solution[:, 4], rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.energy.balance, 0.0, rtol=0, atol=1e-10)
