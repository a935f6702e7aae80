"""Errors of the derivatives of coarse runs, beside derivatives of two links by SciPy in minimal coordinates."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.gradients.bouncing_ball import MEASURES as OF_BALL
from tests.gradients.bouncing_ball import ball, expected

import mbdkit
from mbdkit_report.pages.answer_section import gradient_section

PARAMETERS = {"k": 40.0, "m1": 3.0, "m2": 2.0, "l1": 0.45, "l2": 0.4}
DAMPING, GRAVITY = 0.2, 9.81
LINKS: dict[str, Any] = {
    "mbdkit": 1,
    "parameters": PARAMETERS,
    "model": {
        "name": "mechanism",
        "bodies": {
            "thigh": {"mass": "m1", "inertia": "m1*l1**2/12", "position": ["l1/2", 0]},
            "shank": {"mass": "m2", "inertia": "m2*l2**2/12", "position": ["l1 + l2/2", 0]},
        },
        "joints": {
            "hip": {"type": "revolute", "bodies": ["ground", "thigh"], "at": [0, 0]},
            "knee": {"type": "revolute", "bodies": ["thigh", "shank"], "at": ["l1", 0]},
        },
        "forces": {
            "spring": {"type": "torsion-spring", "bodies": ["thigh", "shank"], "stiffness": "k", "damping": DAMPING}
        },
    },
}
MEASURES = {"end": "final(shank.x)", "turning": "rms(thigh.angle)"}


def own_measures(values: np.ndarray) -> np.ndarray:
    """Return the measures after 1 s for values of the parameters."""
    k, m1, m2, l1, l2 = values

    def rates(_: float, y: np.ndarray) -> list[float]:
        a, b, wa, wb = y[:4]
        m11, m22, m12 = m1 * l1**2 / 3 + m2 * l1**2, m2 * l2**2 / 3, m2 * l1 * l2 / 2 * np.cos(a - b)
        blow, torque = m2 * l1 * l2 / 2 * np.sin(a - b), -k * (b - a) - DAMPING * (wb - wa)
        first = -torque - blow * wb**2 - (m1 / 2 + m2) * GRAVITY * l1 * np.cos(a)
        second = torque + blow * wa**2 - m2 * GRAVITY * l2 / 2 * np.cos(b)
        whole = m11 * m22 - m12**2
        return [wa, wb, (m22 * first - m12 * second) / whole, (m11 * second - m12 * first) / whole, a * a]

    y = solve_ivp(rates, (0.0, 1.0), np.zeros(5), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return np.array([l1 * np.cos(y[0]) + l2 / 2 * np.cos(y[1]), np.sqrt(y[4])])


@cache
def own_jacobian() -> np.ndarray:
    """Return the derivatives (2, 5) of the measures, by differences of order 4."""
    values = np.array([*PARAMETERS.values()])
    columns = []
    for i, value in enumerate(values):
        step = 5e-4 * max(1.0, value) * np.eye(len(values))[i]
        near, far = (own_measures(values + n * step) - own_measures(values - n * step) for n in (1, 2))
        columns.append((8.0 * near - far) / (12.0 * step[i]))
    return np.array(columns).T


@pytest.mark.parametrize(
    ("integrator", "step"),
    [({"name": "rk4"}, 0.02), ({"name": "gauss", "stages": 1}, 0.05), ({"name": "radau-iia", "stages": 2}, 0.02)],
    ids=["rk4", "gauss", "radau"],
)
def test_each_derivative_of_a_coarse_run_has_its_error(integrator: dict[str, Any], step: float) -> None:
    found = mbdkit.gradient(LINKS, MEASURES, [*PARAMETERS], integrator=integrator, time={"end": 1.0, "step": step})
    np.testing.assert_allclose(found.error, np.abs(found.jacobian - own_jacobian()), rtol=1e-2)


def test_a_small_derivative_with_the_wrong_sign_fails_the_check() -> None:
    # the derivative with respect to k is 1e-5 of the largest one if both are multiplied by their parameters
    sections = {"integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.02}}
    found = mbdkit.gradient(LINKS, {"end": MEASURES["end"]}, [*PARAMETERS], **sections)
    assert found["end", "k"] * own_jacobian()[0, 0] < 0.0
    assert found.check is not None
    assert found.check.is_like_steps.all()
    assert not found.check.is_passed
    assert found.check.is_accurate.tolist() == [[False, True, True, True, True]]
    assert "the derivative of 'end' is inaccurate with respect to 'k', 1e-07 +- 2.1e-07: use smaller" in found.doubts[0]
    assert "  by k    1e-07 +- 2.1e-07\n" in str(found)
    assert "1e-07 \u00b1 2.1e-07" in found._repr_html_()
    run = mbdkit.run(LINKS, measures={"end": MEASURES["end"]}, gradients=["k"], **sections)
    assert run.gradients["end"]["errors"]["k"] == pytest.approx(found.error[0, 0], rel=1e-6)
    assert "end by k: 1e-07 +- 2.1e-07" in run.summary()
    assert not run.gradients["end"]["check"]["agrees"]
    assert run.verdict in ("doubtful", "bad")
    assert any("The check of the gradients failed for end" in reason for reason in run.verdict_reasons)
    section = gradient_section(run)
    assert section is not None
    ((measure, unit, name, value, *_),) = section.tables[0].rows
    assert (measure, unit, name, f"{value:.0e}") == ("end", "m", "k", "1e-07")
    assert section.sentences[0].startswith("The derivative of 'end' is inaccurate")


def test_errors_through_a_jump_of_a_force_are_true() -> None:
    # expected: the closed form
    found = mbdkit.gradient(ball(0.9, 0.02, {"name": "rk4"}), OF_BALL, ["y", "k", "c"])
    np.testing.assert_allclose(found.error, np.abs(found.jacobian - expected(0.9)), rtol=2e-2)


@pytest.mark.parametrize("inertia", [1e-3, 1e-4, 1e-9])
def test_small_positive_parameters_have_checked_derivatives(inertia: float) -> None:
    # expected: the closed form, 0.3 cos(t sqrt(k / I))
    spec = {
        "mbdkit": 1,
        "parameters": {"I": inertia, "k": 7.0 * inertia},
        "model": {
            "name": "mechanism",
            "gravity": [0, 0],
            "bodies": {"b": {"mass": 1e-3, "inertia": "I", "angle": 0.3}},
            "joints": {"p": {"type": "revolute", "bodies": ["ground", "b"], "at": [0, 0]}},
            "forces": {"s": {"type": "torsion-spring", "bodies": ["ground", "b"], "stiffness": "k"}},
        },
        "integrator": {"name": "gauss", "stages": 2},
        "time": {"end": 2.0, "step": 0.05},
    }
    found = mbdkit.gradient(spec, "final(b.angle)", ["I", "k"])
    angle = 2.0 * np.sqrt(7.0)
    right = 0.15 * np.sin(angle) * angle / np.array([[inertia, -7.0 * inertia]])
    assert found.check is not None
    assert found.check.is_passed, str(found)
    np.testing.assert_allclose(found.error, np.abs(found.jacobian - right), rtol=1e-3)
