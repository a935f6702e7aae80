"""Steps, rows and times of fixed-step runs, whatever the stretches that they are cut into."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from mbdkit.integrators import interface
from tests.margins import assert_within
from tests.slow_cases import slow

from .running import DOUBLE, FIXED, driven_chain, run, spec_run

RODS = {"name": "single-pendulum", "angle": -1.0}

TIMES = [
    (end, step, every)
    for (end, step), every in itertools.product(
        [(1.0, 0.1), (1.0, 0.3), (0.7, 0.1), (0.25, 0.25), (0.2, 0.25), (1.0, 1 / 3), (0.99, 0.1)],
        [1, 2, 3, 7, 10, 11, 1000],
    )
]


@pytest.mark.parametrize(("end", "step", "every"), TIMES)
def test_rows_are_the_start_every_kth_step_and_the_end_and_never_twice(end: float, step: float, every: int) -> None:
    # expected: N = ceil((end - start)/step - 1e-9) steps, t = start + k step, the end exactly
    start = 0.4
    result = spec_run(
        RODS, {"name": "rk4"}, {"start": start, "end": start + end, "step": step}, output={"every": every}
    )
    steps = math.ceil((start + end - start) / step - 1e-9)
    numbers = sorted({0, steps, *range(every, steps, every)})
    expected = np.array([start + k * step for k in numbers])
    expected[-1] = start + end
    np.testing.assert_array_equal(result.time, expected)
    assert result.stats["steps"] == result.stats["accepted"] == steps
    np.testing.assert_array_equal(result.array("steps/time"), expected[1:])
    np.testing.assert_array_equal(result.array("steps/steps"), np.diff(numbers))


@pytest.mark.parametrize("integrator", FIXED, ids=str)
@pytest.mark.parametrize(("end", "step"), [(1.0, 0.3), (0.2, 0.25)])
def test_the_last_step_is_shorter_and_ends_exactly_at_the_end(
    integrator: dict[str, Any], end: float, step: float
) -> None:
    # expected: a free fall is a polynomial of degree 2, which every method of order 2 integrates exactly
    m = driven_chain()
    m.joints.clear()
    m.forces.clear()
    result = run(m, integrator, end=end, step=step)
    assert result.time[-1] == end
    size = result.array("steps/size")
    rest = end - step * (math.ceil(end / step) - 1)
    np.testing.assert_allclose(size[-1], rest, rtol=1e-12)
    fall = -9.81 * end**2 / 2
    position = np.asarray(result["r0"].position)
    np.testing.assert_allclose(position[-1] - position[0], [0.0, fall], rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.asarray(result["r0"].velocity)[-1], [0.0, -9.81 * end], rtol=0, atol=1e-14)


@pytest.mark.parametrize("integrator", FIXED, ids=str)
def test_a_shorter_last_step_keeps_the_order_of_the_method(integrator: dict[str, Any]) -> None:
    # expected: the same end as with steps that divide the time evenly, to the error of the method
    even = run(DOUBLE, integrator, end=1.0, step=0.01)
    odd = run(DOUBLE, integrator, end=1.0, step=0.00999)
    assert odd.stats["steps"] == 101
    tolerance = 1e-4 if integrator.get("stages") == 1 else 1e-7
    np.testing.assert_allclose(odd["rod2"].position[-1], even["rod2"].position[-1], rtol=0, atol=tolerance)


APART: dict[str, Any] = {"output": {"every": 9}, "limits": {"misalignment": 1e9}}
"""Sections of a run whose joints may drift apart: it is about the time alone."""


def test_time_is_never_summed_up() -> None:
    # expected: t_k = start + k h in one rounding each; a running sum of 0.1 is off by 1e-9 after 1e5 steps
    result = spec_run(RODS, {"name": "rk4"}, {"start": 3.0, "steps": 100_000, "step": 0.1}, **APART)
    k = np.append(np.arange(0, 100_000, 9), 100_000)
    np.testing.assert_array_equal(result.time, 3.0 + k * 0.1)


@pytest.mark.parametrize(
    "integrator", [{"name": "rk-gill"}, {"name": "gauss"}, {"name": "gauss", "stages": 3}], ids=str
)
@pytest.mark.parametrize("every", [7, *slow(1, 400)])
def test_results_do_not_depend_on_the_stretches_that_a_run_is_cut_into(
    integrator: dict[str, Any], every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # expected: equal to the bit, hash of all arrays included
    hashes = []
    for length in (1e-9, 0.1, 100.0):
        monkeypatch.setattr(interface, "STRETCH", length)
        result = spec_run(driven_chain(), integrator, {"end": 1.0, "step": 0.003}, output={"every": every})
        hashes.append((result.check().data_sha256, {k: v for k, v in result.stats.items() if not k.endswith("_s")}))
    assert hashes[0] == hashes[1] == hashes[2]


def test_more_rows_than_the_buffer_holds_are_all_kept() -> None:
    result = run(RODS, {"name": "rk4"}, steps=20_000, step=1e-3)
    np.testing.assert_array_equal(result.time, [k * 1e-3 for k in range(20_001)])
    angle = np.asarray(result["rod1"].angle)
    assert np.abs(np.diff(angle)).max() < 0.01
    assert len(np.unique(angle)) > 19_000


def test_sums_of_a_million_steps_are_compensated() -> None:
    # expected: free fall in exact arithmetic, x = x0 + v t - g t^2 / 2, in which RK4 makes no error of its own
    steps, step, speed = 1_000_000, 1e-3, 4905.3
    m = driven_chain()
    m.joints.clear()
    m.forces.clear()
    m.bodies["r0"] = m.bodies["r0"].model_copy(update={"velocity": (1 / 3, speed), "angular_velocity": 0.1})
    result = spec_run(m, {"name": "rk4"}, {"steps": steps, "step": step}, output={"every": steps})
    start = m.bodies["r0"]
    t = float(result.time[-1])
    exact = [start.position[0] + t / 3, start.position[1] + speed * t - 9.81 * t * t / 2]
    error = np.abs(np.asarray(result["r0"].position)[-1] - exact).max()
    turn = abs(float(result["r0"].angle[-1]) - start.angle - 0.1 * t)
    y, v = start.position[1], speed
    for _ in range(steps):  # the same sum without compensation
        y += step * v - step * step * 9.81 / 2
        v -= step * 9.81
    plain = abs(y - exact[1])
    assert_within(error, 1e-8)  # the sum passes through 1.2e6 m, whose round-off is 2e-10 m
    assert_within(turn, 1e-13)
    assert plain > 100 * error
