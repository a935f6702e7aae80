"""Knots and corners of motions, against times and jumps known analytically; jets against the engine's kernels."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mbdkit.engine.kernels.motions import OPCODES, motions_at
from mbdkit.expressions.parser import Expression
from mbdkit.mechanism.motion_corners import corners_of, jet_of, overshoot
from mbdkit.mechanism.values import Table

ONE = 1.0 / 3.0


@pytest.mark.parametrize(
    ("motion", "start", "end", "times"),
    [
        ("sin(t) + t**2", 0.0, 10.0, []),
        ("min(t, 1)", 0.0, 2.0, [1.0]),
        ("100*max(0, 1 - abs(t - 5)/0.05)", 0.0, 10.0, [4.95, 5.0, 5.05]),
        ("max(0, 1 - abs(t - 1/3)/1e-6)", 0.0, 1000.0, [ONE - 1e-6, ONE, ONE + 1e-6]),
        ("abs(sin(pi*t))", 0.5, 3.5, [1.0, 2.0, 3.0]),
        ("abs((t - 1)**2 - 1e-8)", 0.0, 3.0, [1.0 - 1e-4, 1.0 + 1e-4]),  # both roots between two samples
        ("abs((t - 1)**2)", 0.0, 3.0, []),
        ("max(0, max(0, t - 1) - 1)", 0.0, 4.0, [1.0, 2.0]),
        ("abs(1000 + t - 1005)", 0.0, 10.0, [5.0]),
        ("atan2(sin(2*pi*t), cos(2*pi*t))", 0.0, 2.0, [0.5, 1.5]),
        ("sin(atan2(sin(2*pi*t), cos(2*pi*t)))", 0.0, 2.0, []),
        ("atan2(t - 1, 2)", 0.0, 2.0, []),
        ("abs(1/(t - 1))", 0.0, 2.0 * math.sqrt(2.0), []),  # a pole is no corner
    ],
)
def test_corners_are_found_where_they_are(motion: str, start: float, end: float, times: list[float]) -> None:
    found = [corner.time for corner in corners_of(motion, start, end)]
    assert found == pytest.approx(times, rel=1e-12)


@pytest.mark.parametrize(
    ("motion", "before", "after", "jumps"),
    [
        ("min(t, 1)", (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (False, True, False)),
        ("3*abs(t - 1)", (0.0, -3.0, 0.0), (0.0, 3.0, 0.0), (False, True, False)),
        ("max(0, t - 1)**2", (0.0, 0.0, 0.0), (0.0, 0.0, 2.0), (False, False, True)),
        ("max(0, t - 1)**3", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (False, False, False)),
        ("max(0, t - 1)**2.5", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (False, False, False)),
        ("abs(t - 1)/(t - 1)", (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (True, False, False)),
    ],
)
def test_the_jumps_are_those_of_both_sides(
    motion: str, before: tuple[float, ...], after: tuple[float, ...], jumps: tuple[bool, ...]
) -> None:
    (corner,) = corners_of(motion, 0.0, 2.5)
    assert corner.time == pytest.approx(1.0, abs=1e-15)
    assert corner.jumps == jumps
    assert corner.before == pytest.approx(before, abs=1e-12)
    assert corner.after == pytest.approx(after, abs=1e-6 if "2.5" in motion else 1e-12)


@pytest.mark.parametrize(("power", "jumps"), [(1.1, False), (1.5, False), (1.9, False), (1.0, True)])
def test_the_rate_of_a_power_above_one_has_no_jump_where_it_begins(power: float, jumps: bool) -> None:
    (corner,) = corners_of(f"max(0, t - 0.5)**{power}", 0.0, 1.0)
    assert corner.jumps[:2] == (False, jumps)


def test_an_atan2_that_wraps_jumps_by_two_pi() -> None:
    (corner,) = corners_of("atan2(sin(t), cos(t))", 0.0, 6.0)
    assert corner.time == pytest.approx(math.pi, abs=2e-15)
    assert corner.jumps == (True, False, False)
    assert corner.before[0] - corner.after[0] == pytest.approx(2.0 * math.pi)


def test_the_sides_of_a_corner_are_told_apart_in_spite_of_rounding() -> None:
    # 1e6 + t is rounded to 1e-10 s, far more than the rounding of t
    (corner,) = corners_of("abs(1e6 + t - 1000005)", 0.0, 10.0)
    assert corner.jumps[1]
    for side, rate in ((-1.0, -1.0), (1.0, 1.0)):
        there = jet_of("abs(1e6 + t - 1000005)", np.array([corner.time + side * corner.margin]))
        assert there.rate[0] == rate


def test_knots_of_a_spline_are_smooth_and_those_of_lines_are_not() -> None:
    points = ((0.0, 1.0, 2.0, 3.0, 4.0), (0.0, 1.0, 0.0, 2.0, 1.0))
    cubic = corners_of(Table(table=points), 0.0, 4.0)
    assert [corner.time for corner in cubic] == [1.0, 2.0, 3.0]
    assert all(corner.is_knot and corner.is_smooth for corner in cubic)
    linear = corners_of(Table(table=points, interpolation="linear"), 0.0, 4.0)
    assert [(corner.before[1], corner.after[1]) for corner in linear] == [(1.0, -1.0), (-1.0, 2.0), (2.0, -1.0)]
    assert all(corner.jumps == (False, True, False) for corner in linear)
    assert [corner.time for corner in corners_of(Table(table=points), 1.5, 2.5)] == [2.0]


def test_the_overshoot_of_a_table_is_that_of_its_spline() -> None:
    steps = ((0.0, 1.0, 1.01, 1.5, 1.51, 2.0), (0.0, 0.0, 10.0, 10.0, 0.0, 0.0))
    assert overshoot(Table(table=steps)) > 10.0
    assert overshoot(Table(table=steps, interpolation="linear")) == 0.0
    # the parabola 4 t (1 - t) through (0, 0), (0.25, 0.75), (1, 0) reaches 1
    assert overshoot(Table(table=((0.0, 0.25, 1.0), (0.0, 0.75, 0.0)))) == pytest.approx(0.25 / 0.75)


@pytest.mark.parametrize(
    "text",
    [
        "0.5*sin(2*pi*t) - t**3 + 2**t", "atan2(sin(t), 1.2 + cos(t))/(1 + t)", "min(t, 1) + max(t**2, 0.3, sin(t))",
        "abs(t - 1)*exp(-t) + log(1 + t)**1.5", "asin(0.3*t) + acos(0.2*t) + atan(t) + tanh(t) + tan(0.3*t)",
        "sqrt(1 + t*t)**t - (-t)**3",
    ],
)  # fmt: skip
def test_jets_agree_with_those_of_the_engine(text: str) -> None:
    times = np.linspace(0.05, 2.5, 40)
    program = Expression.parse(text).program
    u = np.zeros((len(times), 1, 3))
    ops, values = (np.array(column) for column in zip(*[(OPCODES[op], x) for op, x in program], strict=True))
    motions_at(times, np.array([0, len(ops)]), ops, values.astype(float), np.zeros((32, 3)), u)
    assert jet_of(text, times).derivatives == pytest.approx(u[:, 0], rel=1e-11, abs=1e-12)
