"""Slides, welds and tables of motion against closed forms, plain differential equations and SciPy's own spline."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import sympy as sp
from scipy.interpolate import CubicSpline

from tests.margins import assert_within

from . import ode
from .running import gauss, run

G = 9.81


def planar(z: Any) -> np.ndarray:
    """Return complex numbers (T,) as x and y (T, 2)."""
    return np.column_stack([np.real(z), np.imag(z)])


# ---- a slider-crank whose slider is a body on a guide of the ground -------------------------------------------------

CRANK, ROD, SPEED, KNEE = 0.2, 0.7, 5.0, (0.05, -0.03)
"""Lengths of crank and rod [m], angular velocity of the crank [rad/s], the guided point in the slider's frame [m]."""


def slider_crank(guide: dict[str, Any]) -> dict[str, Any]:
    tilt = -math.asin(CRANK * math.sin(0.4) / ROD)
    tip = CRANK * np.exp(0.4j)
    end = tip + ROD * np.exp(1j * tilt)
    return {
        "name": "mechanism",
        "bodies": {
            "crank": {"mass": 1.0, "inertia": 0.01, "position": [tip.real / 2, tip.imag / 2], "angle": 0.4},
            "rod": {
                "mass": 0.6,
                "inertia": 0.02,
                "position": [(tip.real + end.real) / 2, tip.imag / 2],
                "angle": tilt,
            },
            "slider": {"mass": 1.4, "inertia": 0.03, "position": [end.real, 0.0]},
        },
        "joints": {
            "A": {"type": "revolute", "bodies": ["ground", "crank"], "points": [[0.0, 0.0], [-CRANK / 2, 0.0]]},
            "B": {"type": "revolute", "bodies": ["crank", "rod"], "points": [[CRANK / 2, 0.0], [-ROD / 2, 0.0]]},
            "C": {"type": "revolute", "bodies": ["rod", "slider"], "points": [[ROD / 2, 0.0], [0.0, 0.0]]},
            "guide": guide,
            "motor": {
                "type": "driver",
                "bodies": ["ground", "crank"],
                "coordinate": "angle",
                "motion": f"0.4 + {SPEED}*t",
            },
        },
    }


GUIDES = {
    "guide on the ground": (
        {"type": "prismatic", "bodies": ["ground", "slider"], "points": [[-3.0, KNEE[1]], list(KNEE)], "axis": [4, 0]},
        1.0,
    ),
    "ground on a guide of the slider": (
        {"type": "prismatic", "bodies": ["slider", "ground"], "points": [list(KNEE), [9.0, KNEE[1]]], "axis": [-2, 0]},
        -1.0,
    ),
}


@pytest.mark.parametrize("case", GUIDES)
def test_a_slider_crank_has_the_motion_and_the_guide_force_of_its_closed_form(case: str) -> None:
    # expected: x = r cos(phi) + sqrt(l^2 - r^2 sin(phi)^2), differentiated by SymPy; forces by Newton and Euler
    guide, sign = GUIDES[case]
    result = run(slider_crank(guide), gauss(4), end=2.0, step=0.005, every=10)
    t = np.asarray(result.time)
    s = sp.Symbol("s")
    phi = sp.Rational(2, 5) + SPEED * s
    tilt = -sp.asin(CRANK * sp.sin(phi) / ROD)
    x = CRANK * sp.cos(phi) + ROD * sp.cos(tilt)

    def over_time(expression: Any, order: int = 0) -> np.ndarray:
        return np.asarray(sp.lambdify(s, expression.diff(s, order), "numpy")(t))

    np.testing.assert_allclose(result["slider"].position, planar(over_time(x)), rtol=0, atol=1e-10)
    np.testing.assert_allclose(result["slider"].velocity, planar(over_time(x, 1)), rtol=0, atol=1e-9)
    np.testing.assert_allclose(result["slider"].angle, 0.0, rtol=0, atol=1e-13)
    # rod about its centre, rod and slider upwards: unknown pin forces at B (x, y) and C (x, y) and guide force N
    along = over_time(x, 2)
    across = over_time(CRANK * sp.sin(phi) + ROD / 2 * sp.sin(tilt), 2)
    half = ROD / 2 * np.exp(1j * over_time(tilt))
    pin = 1.4 * along  # x force of the rod on the slider
    middle = over_time(CRANK * sp.cos(phi) + ROD / 2 * sp.cos(tilt), 2)
    crank_x = 0.6 * middle + pin  # x force of the crank on the rod
    # y: crank_y - pin_y = 0.6 (across + G); moment: -hx crank_y + hy crank_x - hx pin_y + hy pin = 0.02 tilt''
    total = 0.6 * (across + G)
    moment = half.imag * (crank_x + pin) - 0.02 * over_time(tilt, 2)
    pin_y = (moment / half.real - total) / 2
    normal = 1.4 * G - pin_y  # the guide's force on the slider
    np.testing.assert_allclose(result.joints["C"].reaction_force, np.column_stack([pin, pin_y]), rtol=0, atol=1e-7)
    force = np.asarray(result.joints["guide"].reaction_force)
    np.testing.assert_allclose(force, np.column_stack([0 * t, sign * normal]), rtol=0, atol=1e-7)
    # the slider does not turn, so N goes through its centre; the torque is about the second body's joint point
    torque = -KNEE[0] * normal if sign > 0 else (9.0 - over_time(x)) * normal
    np.testing.assert_allclose(result.joints["guide"].reaction_torque, torque, rtol=0, atol=1e-7)
    assert_within(result.joints["guide"].misalignment_max, 1e-9)


# ---- a slider on an arm that turns ----------------------------------------------------------------------------------

ARM, SLIDER = {"mass": 1.3, "inertia": 0.2}, {"mass": 0.8, "inertia": 0.05}
PIVOT, START, AXIS, HELD, TWIST = -0.4 + 0.1j, 0.2 - 0.15j, 2.0 + 1.0j, 0.12 + 0.07j, 0.6
"""Pivot and guide point in the arm's frame, axis of the guide, the guided point in the slider's frame, its twist."""
STIFFNESS, DAMPING, FREE = 40.0, 0.3, 0.5
DIRECTION = AXIS / abs(AXIS)
INERTIA = ARM["inertia"] + ARM["mass"] * abs(PIVOT) ** 2 + SLIDER["inertia"]
GRAVITY = -1j * G


def motor(t: Any) -> Any:
    return 1.5 * np.cos(2 * t)


def from_pivot(s: Any) -> Any:
    """Return the slider's centre in the arm's frame, from the pivot."""
    return START - PIVOT + s * DIRECTION - HELD * np.exp(1j * TWIST)


def turning_arm_rates(t: Any, y: Any) -> Any:
    """Return the rates of angle, s and their rates: Newton along the guide, moment of momentum about the pivot."""
    angle, s, omega, speed = y[:4]
    w = from_pivot(s)
    fall = GRAVITY * np.exp(-1j * angle)
    lever = (np.conj(w) * DIRECTION).imag
    pull = -STIFFNESS * (s - FREE) - DAMPING * speed
    m = SLIDER["mass"]
    matrix = np.array([[m, m * lever], [m * lever, INERTIA + m * abs(w) ** 2]])
    along = (np.conj(DIRECTION) * (m * fall + m * omega**2 * w)).real + pull
    about = (
        ARM["mass"] * (np.conj(-PIVOT) * fall).imag
        + m * (np.conj(w) * fall).imag
        - 2 * m * omega * speed * (np.conj(w) * DIRECTION).real
        + motor(t)
    )
    s_acc, alpha = np.linalg.solve(matrix, [along, about])
    return np.array([omega, speed, alpha, s_acc, DAMPING * speed**2])


def turning_arm(angle: float, s: float, omega: float, speed: float) -> dict[str, Any]:
    turn = np.exp(1j * angle)
    arm, slider = -PIVOT * turn, from_pivot(s) * turn
    moving = (1j * omega * from_pivot(s) + speed * DIRECTION) * turn

    def pair(z: complex) -> list[float]:
        return [z.real, z.imag]

    return {
        "name": "mechanism",
        "bodies": {
            "arm": {
                **ARM,
                "position": pair(arm),
                "angle": angle,
                "velocity": pair(1j * omega * arm),
                "angular_velocity": omega,
            },
            "slider": {
                **SLIDER,
                "position": pair(slider),
                "angle": angle + TWIST,
                "velocity": pair(moving),
                "angular_velocity": omega,
            },
        },
        "joints": {
            "pivot": {"type": "revolute", "bodies": ["ground", "arm"], "points": [[0.0, 0.0], pair(PIVOT)]},
            "slide": {
                "type": "prismatic",
                "bodies": ["arm", "slider"],
                "points": [pair(START), pair(HELD)],
                "axis": pair(AXIS),
            },
        },
        "forces": {
            "spring": {
                "type": "spring-damper",
                "bodies": ["arm", "slider"],
                "points": [pair(START), pair(HELD)],
                "stiffness": STIFFNESS,
                "damping": DAMPING,
                "free_length": FREE,
            },
            "motor": {"type": "torque", "body": "arm", "value": "1.5*cos(2*t)"},
        },
    }


def test_a_slider_on_a_turning_arm_follows_its_two_equations_of_motion() -> None:
    # expected: two minimal coordinates by DOP853 at rtol 1e-13; guide force and torque by Newton and Euler on them
    start = np.array([-0.3, 0.6, 0.8, -0.4, 0.0])
    result = run(turning_arm(*start[:4]), gauss(4), end=3.0, step=0.005, every=20)
    t = np.asarray(result.time)
    y = ode.dop853(turning_arm_rates, start, t)
    angle, s, omega, speed = y.T[:4]
    assert s.min() > 0.05  # the spring's length is s
    w, turn = from_pivot(s), np.exp(1j * angle)
    np.testing.assert_allclose(result["arm"].angle, angle, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result["slider"].angle, angle + TWIST, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result["slider"].position, planar(w * turn), rtol=0, atol=1e-9)
    velocity = (1j * omega * w + speed * DIRECTION) * turn
    np.testing.assert_allclose(result["slider"].velocity, planar(velocity), rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.energy.dissipated, y[:, 4], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.energy.balance, 0.0, rtol=0, atol=1e-9)
    rates = np.array([turning_arm_rates(*row) for row in zip(t, y, strict=True)])
    alpha, s_acc = rates[:, 2], rates[:, 3]
    acceleration = (s_acc * DIRECTION + 2j * omega * speed * DIRECTION + (1j * alpha - omega**2) * w) * turn
    pull = (-STIFFNESS * (s - FREE) - DAMPING * speed) * DIRECTION * turn
    force = SLIDER["mass"] * (acceleration - GRAVITY) - pull
    np.testing.assert_allclose((np.conj(DIRECTION * turn) * force).real, 0.0, atol=1e-12)  # the guide is smooth
    arm = HELD * np.exp(1j * (angle + TWIST))
    torque = SLIDER["inertia"] * alpha - (np.conj(arm) * (force + pull)).imag
    np.testing.assert_allclose(result.joints["slide"].reaction_force, planar(force), rtol=0, atol=1e-7)
    np.testing.assert_allclose(result.joints["slide"].reaction_torque, torque, rtol=0, atol=1e-7)


# ---- bodies welded together -----------------------------------------------------------------------------------------


def test_two_welded_rods_swing_as_the_one_rigid_body_that_they_are() -> None:
    # expected: the compound pendulum J theta'' = -M g h cos(theta + beta) by DOP853 at rtol 1e-13
    bend, start = 1.1, 0.2
    first, second = 0.5 + 0j, 1.0 + 0.3 * np.exp(1j * bend)  # centres from the pin, in the first rod's frame
    masses, inertias = (1.0, 0.7), (1.0 / 12, 0.7 * 0.36 / 12)
    turn = np.exp(1j * start)
    model = {
        "name": "mechanism",
        "bodies": {
            "one": {"mass": 1.0, "inertia": inertias[0], "position": list(planar(first * turn)[0]), "angle": start},
            "two": {
                "mass": 0.7,
                "inertia": inertias[1],
                "position": list(planar(second * turn)[0]),
                "angle": start + bend,
            },
        },
        "joints": {
            "pin": {"type": "revolute", "bodies": ["ground", "one"], "points": [[0.0, 0.0], [-0.5, 0.0]]},
            "weld": {"type": "weld", "bodies": ["one", "two"], "points": [[0.5, 0.0], [-0.3, 0.0]]},
        },
    }
    result = run(model, gauss(4), end=4.0, step=0.005, every=20)
    t = np.asarray(result.time)
    centre = masses[0] * first + masses[1] * second
    whole = sum(inertias) + masses[0] * abs(first) ** 2 + masses[1] * abs(second) ** 2

    def rates(_: Any, y: Any) -> Any:
        return np.array([y[1], -G * (centre * np.exp(1j * y[0])).real / whole])

    solution = ode.dop853(rates, np.array([start, 0.0]), t)
    turns = np.exp(1j * solution[:, 0])
    np.testing.assert_allclose(result["one"].position, planar(first * turns), rtol=0, atol=1e-10)
    np.testing.assert_allclose(result["two"].position, planar(second * turns), rtol=0, atol=1e-10)
    np.testing.assert_allclose(result["two"].angle, solution[:, 0] + bend, rtol=0, atol=1e-10)
    # what the weld carries: Newton and Euler for the second rod
    alpha = -G * (centre * turns).real / whole
    force = masses[1] * ((1j * alpha - solution[:, 1] ** 2) * second * turns - GRAVITY)
    torque = inertias[1] * alpha - (np.conj(-0.3 * np.exp(1j * bend) * turns) * force).imag
    np.testing.assert_allclose(result.joints["weld"].reaction_force, planar(force), rtol=0, atol=1e-8)
    np.testing.assert_allclose(result.joints["weld"].reaction_torque, torque, rtol=0, atol=1e-8)


# ---- motions by table -----------------------------------------------------------------------------------------------

TIMES = [0.0, 0.2, 0.5, 0.9, 1.4, 1.6, 2.0]
ANGLES = [0.3, 0.5, 0.2, -0.4, 0.1, 0.6, 0.9]


@pytest.mark.parametrize("integrator", [gauss(3), {"name": "scipy-dop853", "rtol": 1e-12, "atol": 1e-12}], ids=str)
def test_forces_and_torques_by_table_push_by_the_integral_of_the_spline(integrator: dict[str, Any]) -> None:
    # expected: the second antiderivative of SciPy's CubicSpline over mass or inertia
    model = {
        "name": "mechanism",
        "gravity": [0.0, 0.0],
        "bodies": {"puck": {"mass": 2.0, "inertia": 0.5, "position": [0.0, 0.0]}},
        "forces": {
            "push": {"type": "force", "body": "puck", "value": [{"table": [TIMES, ANGLES]}, 0.5]},
            "spin": {"type": "torque", "body": "puck", "value": {"table": [TIMES, ANGLES[::-1]]}},
        },
    }
    result = run(model, integrator, end=2.0, step=0.01)
    t = np.asarray(result.time)
    pushed, spun = (CubicSpline(TIMES, column).antiderivative(2)(t) for column in (ANGLES, ANGLES[::-1]))
    place = np.column_stack([pushed / 2, 0.5 * t**2 / 4])
    np.testing.assert_allclose(result["puck"].position, place, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result["puck"].angle, spun / 0.5, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.energy.balance, 0.0, rtol=0, atol=1e-9)
