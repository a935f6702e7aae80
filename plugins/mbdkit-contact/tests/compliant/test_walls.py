"""Bodies do not pass through thin walls: adaptive steps end where contacts begin and end, and fixed ones are told.

Expected motions are closed-form up to the wall, and SciPy's DOP853 of the force of Hunt and Crossley in contact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbdkit
from tests.benchmarks.drawn_contacts import compliant, study

RADIUS, FAR, THICK, SPEED, STIFFNESS, DAMPING = 0.05, 1.9, 0.002, 4.5, 1e6, 0.1
METHODS: list[dict[str, Any]] = [
    {"name": "dop853", "adaptive": True},
    {"name": "dopri5", "adaptive": True, "rtol": 1e-9},
    {"name": "radau-iia", "stages": 3, "adaptive": True},
    {"name": "gauss", "stages": 3, "adaptive": True},
    {"name": "scipy-dop853"},
    {"name": "scipy-lsoda"},
]


def wall(**body: Any) -> dict[str, Any]:
    shapes = [
        {"polygon": [[FAR, -30], [FAR + THICK, -30], [FAR + THICK, 30], [FAR, 30]]}, {"circle": {"radius": RADIUS}}
    ]  # fmt: skip
    compliance = {"stiffness": STIFFNESS, "dissipation": DAMPING}
    return {
        "name": "mechanism", "gravity": [0, 0],
        "bodies": {"b": {"mass": 1.0, "inertia": 0.001, "velocity": [SPEED, 0.0], **body}},
        "contacts": {"c": {"bodies": ["ground", "b"], "shapes": shapes, "compliance": compliance}},
    }  # fmt: skip


def expected(end: float) -> float:
    def rates(_t: float, y: np.ndarray) -> list[float]:
        depth = max(y[0], 0.0)
        return [y[1], -STIFFNESS * depth**1.5 * max(1.0 + 1.5 * DAMPING * y[1], 0.0)]

    def leaves(t: float, y: np.ndarray) -> float:
        return float(y[0]) if t > 1e-6 else 1.0

    leaves.terminal = True  # type: ignore[attr-defined]
    touch = (FAR - RADIUS) / SPEED
    inside = solve_ivp(rates, (0.0, 0.1), [0.0, SPEED], method="DOP853", rtol=1e-12, atol=1e-14, events=leaves,
                       max_step=1e-4)  # fmt: skip
    return float(FAR - RADIUS + inside.y[1, -1] * (end - touch - inside.t[-1]))


@pytest.mark.parametrize("method", METHODS, ids=lambda method: str(method["name"]))
def test_a_ball_bounces_off_a_wall_of_two_millimetres(method: dict[str, Any]) -> None:
    run = mbdkit.run({"mbdkit": 1, "model": wall(), "integrator": method, "time": {"end": 0.7}})
    assert run["b"].position[-1, 0] == pytest.approx(expected(0.7), abs=3e-4)


def test_rows_of_adaptive_runs_show_both_ends_of_a_contact() -> None:
    method = {"name": "dop853", "adaptive": True, "rtol": 1e-9}
    run = mbdkit.run({"mbdkit": 1, "model": wall(), "integrator": method, "time": {"end": 0.7}})
    gaps = np.min([run.contacts[name].gap for name in run.contacts], axis=0)
    assert np.sum(np.abs(gaps) < 1e-9) >= 2


def test_fixed_steps_that_may_jump_over_a_wall_are_told() -> None:
    def verdict(step: float) -> tuple[str, str]:
        run = mbdkit.run(
            {"mbdkit": 1, "model": wall(), "integrator": {"name": "rk4"}, "time": {"end": 0.5, "step": step}}
        )
        return run.verdict, " ".join(run.warnings)

    level, sentence = verdict(0.05)
    assert level in ("doubtful", "bad")
    assert "may pass through each other; use a smaller time.step" in sentence
    assert verdict(1e-4) == ("unknown", "")


@pytest.mark.parametrize("number", [105, 822, 905])
def test_libraries_pass_the_jump_of_the_force_of_a_damper(number: int) -> None:
    is_right, _, what = compliant(np.random.default_rng([1, number]))
    assert is_right, what


def test_a_step_from_a_touch_sees_a_contact_that_it_leaves_deep_inside() -> None:
    # its end lies beyond the centre of the other ball, where the shapes separate and the damper takes all force away
    is_right, _, what = compliant(np.random.default_rng([4, 285]))
    assert is_right, what


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compliant", "rigid"])
def test_drawn_scenes_are_right_or_told(name: str) -> None:
    counts = study(name, 60, 1)
    assert counts["silent"] == 0
    assert counts["right"] >= 57
