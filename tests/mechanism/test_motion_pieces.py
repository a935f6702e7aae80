"""Pieces of functions of time, and the corners that expressions hide."""

import math
from itertools import pairwise

import pytest

from mbdkit.expressions.parser import Expression
from mbdkit.mechanism.motion_corners import corners_of
from mbdkit.mechanism.motion_pieces import pieces_of, step_limits
from tests.benchmarks.functions_of_time import wrong


def limits(text: str, end: float) -> list[tuple[float, float]]:
    return step_limits([Expression.parse(text).program], 0.0, end, 5000)


@pytest.mark.parametrize(
    ("motion", "time", "before", "after"),
    [
        ("asin(sin(3*t))", math.pi / 6, (math.pi / 2, 3.0), (math.pi / 2, -3.0)),
        ("acos(cos(3*t))", math.pi / 3, (math.pi, 3.0), (math.pi, -3.0)),
        ("sqrt((t - 0.7)**2)", 0.7, (0.0, -1.0), (0.0, 1.0)),
        ("((t - 0.7)**2)**0.5 + t", 0.7, (0.7, 0.0), (0.7, 2.0)),
        ("(t - 0.7)*tanh(1e12*(t - 0.7))", 0.7, (0.0, -1.0), (0.0, 1.0)),
        ("exp(0.5*log((t - 0.7)**2))", 0.7, (0.0, -1.0), (0.0, 1.0)),
        ("atan(tan(2*t))", math.pi / 4, (math.pi / 2, 2.0), (-math.pi / 2, 2.0)),
        ("tanh(1e12*(t - 1))", 1.0, (-1.0, 0.0), (1.0, 0.0)),
        ("atan(1/(t - 0.3))", 0.3, (-math.pi / 2, -1.0), (math.pi / 2, -1.0)),
    ],
)
def test_hidden_corners_have_the_limits_of_both_sides(
    motion: str, time: float, before: tuple[float, float], after: tuple[float, float]
) -> None:
    (corner,) = corners_of(motion, 0.0, 1.5)
    assert corner.time == pytest.approx(time, abs=1e-12)
    # rounding errors of 1e-16 over the 1e-10 s beside the steps of 1e-12 s limit their rates
    assert corner.before[:2] == pytest.approx(before, abs=0.2 if "1e12*(t - 1)" in motion else 1e-8)
    assert corner.after[:2] == pytest.approx(after, abs=0.2 if "1e12*(t - 1)" in motion else 1e-8)
    assert corner.jumps[:2] == tuple(abs(b - a) > 1e-6 for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize(
    "motion",
    [
        "tanh(1e5*(t - 1))", "exp(-((t - 0.7)/1e-4)**2)",
        "3*t + sqrt((t - 0.7)**2 + 1e-8)", "1/(1 + exp(-1e4*(t - 1)))",
        "sqrt(2 + sin(5*t))", "acos(0.5*cos(3*t))", "exp(log(1 + t))", "tan(0.5*t)", "sin(asin(sin(t)))",
    ],
)  # fmt: skip
def test_sharp_but_smooth_functions_have_no_corners(motion: str) -> None:
    assert corners_of(motion, 0.0, 1.5) == ()


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4, 1e-5])
def test_a_pulse_far_shorter_than_the_samples_limits_the_steps_over_it(width: float) -> None:
    middle = 0.7123456
    found = limits(f"5*sin(3*t) + exp(-((t - {middle})/{width})**2)", 10.0)
    (begin, size), (end, _) = next(pair for pair in pairwise(found) if pair[0][0] <= middle < pair[1][0])
    assert begin < middle - width
    assert end > middle + width
    assert size < 3.0 * width
    assert sum(size < 0.5 for _, size in found) == 1  # the sine, with a period of 2 s, allows larger steps


def test_smooth_functions_do_not_limit_steps_that_resolve_them() -> None:
    # at a relative tolerance of 1e-4, the error control of order 5 takes steps of about a sixth of the period
    ((_, size),) = limits("10*sin(7*t + 1)", 20.0)
    assert 0.3 * 2 * math.pi / 7 < size < 2 * math.pi / 7
    assert limits("30*t + 2", 1.0) == []
    assert limits("0.5*t**3 - t", 3.0) == []


def test_the_pieces_of_a_sine_are_as_many_as_its_periods_and_no_more() -> None:
    assert 10 <= len(pieces_of(Expression.parse("sin(2*pi*t)").program, 0.0, 20.0).length) <= 40


def test_drawn_functions_have_the_corners_of_their_closed_forms() -> None:
    assert [sentence for sentence in wrong(12, 0) if sentence] == []


@pytest.mark.slow
def test_drawn_integrals_and_momenta_of_loads_at_rest_are_right() -> None:
    assert [sentence for sentence in wrong(60, 4) if sentence] == []
