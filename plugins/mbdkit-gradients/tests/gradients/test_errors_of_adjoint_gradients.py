"""Errors of gradients by the adjoint, beside complex steps of the equations of a double pendulum in its two angles."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from mbdkit.base.errors import RunError
from mbdkit_gradients import other_method

RANGES = {
    "m1": (0.5, 3.0), "m2": (0.5, 3.0), "I1": (0.02, 0.2), "I2": (0.02, 0.2), "s1": (0.2, 0.5), "s2": (0.2, 0.5),
    "length": (0.4, 0.8), "k1": (2.0, 30.0), "free1": (-0.5, 0.5), "c1": (0.05, 1.5), "k2": (2.0, 30.0),
    "free2": (-0.5, 0.5), "c2": (0.05, 1.5), "g": (5.0, 10.0), "angle1": (-1.5, 1.5), "angle2": (-1.5, 1.5),
    "rate1": (-1.5, 1.5), "rate2": (-1.5, 1.5),
}  # fmt: skip
MODEL: dict[str, Any] = {
    "name": "mechanism",
    "gravity": [0, "-g"],
    "bodies": {
        "upper": {
            "mass": "m1", "inertia": "I1", "angle": "angle1", "angular_velocity": "rate1",
            "position": ["s1*cos(angle1)", "s1*sin(angle1)"],
            "velocity": ["-rate1*s1*sin(angle1)", "rate1*s1*cos(angle1)"],
        },
        "lower": {
            "mass": "m2", "inertia": "I2", "angle": "angle2", "angular_velocity": "rate2",
            "position": ["length*cos(angle1) + s2*cos(angle2)", "length*sin(angle1) + s2*sin(angle2)"],
            "velocity": [
                "-rate1*length*sin(angle1) - rate2*s2*sin(angle2)", "rate1*length*cos(angle1) + rate2*s2*cos(angle2)",
            ],
        },
    },
    "joints": {
        "hip": {"type": "revolute", "bodies": ["ground", "upper"], "points": [[0, 0], ["-s1", 0]]},
        "knee": {"type": "revolute", "bodies": ["upper", "lower"], "points": [["length - s1", 0], ["-s2", 0]]},
    },
    "forces": {
        "at_hip": {
            "type": "torsion-spring", "bodies": ["ground", "upper"],
            "stiffness": "k1", "free_angle": "free1", "damping": "c1",
        },
        "at_knee": {
            "type": "torsion-spring", "bodies": ["upper", "lower"],
            "stiffness": "k2", "free_angle": "free2", "damping": "c2",
        },
    },
}  # fmt: skip
MEASURES = {"end": "final(lower.x)", "motion": "integral(energy.kinetic)", "turning": "rms(lower.angle)"}
METHODS: tuple[tuple[dict[str, Any], dict[str, float]], ...] = (
    ({"name": "gauss", "stages": 2}, {"step": 0.05}),
    ({"name": "rk4"}, {"step": 0.01}),
    ({"name": "radau-iia", "stages": 2}, {"step": 0.02}),
    ({"name": "dop853", "adaptive": True, "rtol": 1e-6}, {}),
)


def own_jacobian(values: np.ndarray, end: float) -> np.ndarray:
    """Return the derivatives (3, K) of the measures, by complex steps in all parameters at once."""
    count, change = len(values), 1e-30
    (m1, m2, i1, i2, s1, s2, length, k1, free1, c1, k2, free2, c2, g, *start) = values[:, None] + 1j * change * np.eye(
        count
    )

    def kinetic(a: np.ndarray, b: np.ndarray, wa: np.ndarray, wb: np.ndarray) -> np.ndarray:
        both = m2 * length * s2 * np.cos(a - b) * wa * wb
        return ((m1 * s1**2 + i1 + m2 * length**2) * wa**2 + (m2 * s2**2 + i2) * wb**2) / 2 + both

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        a, b, wa, wb, *_integrals = state.reshape(6, count)
        m11, m22 = m1 * s1**2 + i1 + m2 * length**2, m2 * s2**2 + i2
        m12, blow = (m2 * length * s2 * f(a - b) for f in (np.cos, np.sin))
        knee = -k2 * (b - a - free2) - c2 * (wb - wa)
        hip = -k1 * (a - free1) - c1 * wa
        first = hip - knee - blow * wb**2 - (m1 * s1 + m2 * length) * g * np.cos(a)
        second = knee + blow * wa**2 - m2 * g * s2 * np.cos(b)
        whole = m11 * m22 - m12**2
        acc = (m22 * first - m12 * second) / whole, (m11 * second - m12 * first) / whole
        return np.concatenate([wa, wb, *acc, kinetic(a, b, wa, wb), b * b])

    begin = np.concatenate([*start, np.zeros(2 * count)]).astype(complex)
    solved = solve_ivp(rates, (0.0, end), begin, method="DOP853", rtol=1e-12, atol=1e-12)
    a, b, _, _, work, square = solved.y[:, -1].reshape(6, count)
    measures = length * np.cos(a) + s2 * np.cos(b), work, np.sqrt(square / end)
    return np.array([x.imag / change for x in measures])


@pytest.mark.parametrize(("seed", "method"), [*enumerate(METHODS)], ids=[method["name"] for method, _ in METHODS])
def test_derivatives_by_the_adjoint_have_their_true_errors(
    seed: int, method: tuple[dict[str, Any], dict[str, float]]
) -> None:
    draw = np.random.default_rng(seed)
    values = {name: round(float(draw.uniform(*limits)), 3) for name, limits in RANGES.items()}
    integrator, step = method
    spec = {"mbdkit": 1, "parameters": values, "model": MODEL, "integrator": integrator, "time": {"end": 1.0, **step}}
    found = mbdkit.gradient(spec, MEASURES, [*values], mode="adjoint")
    right = own_jacobian(np.array([*values.values()]), 1.0)
    error = np.abs(found.jacobian - right)
    resolved = 1e-9 * np.max(np.abs(right), axis=1, keepdims=True)  # of the derivatives by complex steps
    np.testing.assert_array_less(error, 2.0 * found.error + resolved)
    np.testing.assert_array_less(found.error, 2.0 * error + resolved)


def test_errors_are_unknown_if_no_other_run_is_differentiated(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object, **__: object) -> None:
        raise RunError("it stops early")

    monkeypatch.setattr(other_method, "AdjointRun", failing)
    monkeypatch.setattr(other_method, "differentiated_run", failing)
    spec = {"mbdkit": 1, "model": {"name": "double-pendulum"}}
    sections: dict[str, Any] = {"integrator": {"name": "rk4"}, "time": {"end": 0.1, "step": 0.02}}
    for mode in ("forward", "adjoint"):
        found = mbdkit.gradient(spec, "final(rod2.x)", ["model.lengths.0", "model.masses.0"], mode=mode, **sections)  # type: ignore[arg-type]
        assert np.isnan(found.error).all()
        (doubt,) = found.doubts
        assert "unknown: no run by another, more accurate method could be differentiated" in doubt
