"""The paper's misalignment figures, and its three methods against the same equations in dense NumPy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from .absolute import AbsoluteRods, rk4, rk_gill
from .running import gauss, run

ANGLE = math.radians(-40.0)
#: Largest misalignment [m] that the paper states, by number of rods and of stages.
PUBLISHED = {(1, 2): 1e-6, (2, 2): 1e-5, (1, 3): 1e-10, (2, 3): 1e-8}
MODELS: dict[int, dict[str, Any]] = {
    1: {"name": "single-pendulum", "length": 20.0, "angle": ANGLE},
    2: {"name": "double-pendulum", "lengths": [20.0, 20.0], "angles": [ANGLE, ANGLE]},
}


@pytest.mark.parametrize(("rods", "stages"), PUBLISHED)
def test_misalignment_has_the_published_magnitude(rods: int, stages: int) -> None:
    # expected: the magnitudes stated in the paper, within a factor of three; we assume L = 20 m and 40 degrees
    result = run(MODELS[rods], gauss(stages), end=15.0, step=0.1)
    assert PUBLISHED[rods, stages] / 3 <= result.misalignment_max <= 3 * PUBLISHED[rods, stages]


@pytest.mark.parametrize("rods", [1, 2, 5])
@pytest.mark.parametrize(("name", "method"), [("rk4", rk4), ("rk-gill", rk_gill)])
def test_explicit_methods_take_the_steps_of_the_textbook_code(rods: int, name: str, method: Any) -> None:
    # expected: the same number of steps by a plain NumPy code with dense matrices; Gill's in his own storage scheme
    lengths = tuple(20.0 / (k + 1) for k in range(rods))
    chain = AbsoluteRods(lengths=lengths, masses=(1.0,) * rods)
    angles = np.linspace(-0.7, -0.2, rods)
    states = method(chain.right_side, chain.state(angles, np.zeros(rods)), 0.05, 60)
    model = {"name": "n-pendulum", "lengths": list(lengths), "angles": angles.tolist()}
    result = run(model, {"name": name}, end=3.0, step=0.05)
    gaps = np.array([chain.misalignment(state) for state in states])
    for k in range(rods):
        body = result[f"rod{k + 1}"]
        np.testing.assert_allclose(body.position, states[:, 3 * k : 3 * k + 2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(body.angle, states[:, 3 * k + 2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(result.joints[f"J{k + 1}"].misalignment, gaps[:, k], rtol=1e-6, atol=1e-11)
