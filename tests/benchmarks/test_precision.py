"""What the race rests on: the reference, the right sides of the others, every contender's equations, the arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.benchmarks.precision import tables
from tests.benchmarks.precision.contender import Contender, Outcome
from tests.benchmarks.precision.measure import Curve, Point, climb
from tests.benchmarks.precision.motions import CHAIN, DOUBLE_PENDULUM, collocate
from tests.benchmarks.precision.race import contenders
from tests.benchmarks.precision.rods import Array, Rods
from tests.margins import assert_within
from tests.witness import hundred_rods
from tests.witness.double_pendulum import HORIZONTAL
from tests.witness.ode import extrapolate

ALL, _ = contenders(DOUBLE_PENDULUM)


@pytest.mark.parametrize("rods", [Rods(2), Rods(3, 0.5, 2.0), CHAIN.rods], ids=lambda rods: f"{rods.count} rods")
def test_joint_forces_and_lagrange_give_the_same_accelerations(rods: Rods) -> None:
    state = np.random.default_rng(5).normal(size=2 * rods.count)
    long = state.astype(np.longdouble)
    lagrange = rods.by_lagrange(0.0, long)
    size = float(np.max(np.abs(lagrange)))
    assert_within(rods.by_joint_forces(0.0, long) - lagrange, 1e-15 * size)
    assert_within(rods.right_side()(0.0, state) - lagrange, 1e-13 * size)


def test_right_sides_do_not_overwrite_what_they_returned() -> None:
    rates = CHAIN.rods.right_side()
    first = rates(0.0, CHAIN.start)
    kept = np.array(first)
    rates(0.0, CHAIN.start + 0.1)
    np.testing.assert_array_equal(first, kept)


WAYS = ("extrapolation of joint forces", "collocation of Lagrange's equations")


def chain_at(way: str, end: float, steps: int) -> Array:
    """Return the centres of the chain's rods in extended precision."""
    if np.finfo(np.longdouble).eps > 1e-18:  # without it neither way can tell the last digits of doubles
        pytest.skip("this platform has no extended precision")
    start, rods = CHAIN.start.astype(np.longdouble), CHAIN.rods
    if way == WAYS[0]:
        state = extrapolate(rods.by_joint_forces, start, end, steps)
    else:
        state = collocate(rods.by_lagrange, start, end, steps, stages=8)
    centres: Array = np.asarray(rods.centres(state[: rods.count]))
    return centres


@pytest.mark.benchmark
@pytest.mark.parametrize("way", WAYS)
def test_both_ways_lead_to_the_digits_of_the_chain(way: str) -> None:
    assert_within(CHAIN.miss(chain_at(way, CHAIN.end, 400)), 1e-14)


@pytest.mark.slow
def test_both_ways_agree_on_the_beginning_of_the_chains_motion() -> None:
    # expected: two formulations and two methods that share nothing, to the last digits of doubles
    one, other = (chain_at(way, CHAIN.end / 10, 40) for way in WAYS)
    assert_within(one - other, 1e-15)


@pytest.mark.slow
def test_collocation_of_two_rods_leads_to_the_digits_of_the_double_pendulum() -> None:
    assert HORIZONTAL.start_angle == DOUBLE_PENDULUM.angle
    start = DOUBLE_PENDULUM.start.astype(np.longdouble)
    state = collocate(DOUBLE_PENDULUM.rods.by_joint_forces, start, DOUBLE_PENDULUM.end, 500, stages=6)
    assert_within(DOUBLE_PENDULUM.miss(DOUBLE_PENDULUM.rods.centres(state[:2])), 2e-14)


def test_the_chain_starts_as_its_digits_say() -> None:
    assert hundred_rods.START == CHAIN.angle == pytest.approx(0.5 - math.pi / 2, abs=1e-16)
    assert len(hundred_rods.ANGLES) == CHAIN.rods.count


@pytest.mark.parametrize("contender", ALL, ids=lambda contender: contender.name)
def test_every_contender_solves_the_double_pendulum(contender: Contender) -> None:
    """Within its ladder, coarse to fine, each comes to 1e-4 m of the digits; its finer settings go on from there."""
    missed = []
    for setting in contender.ladder[4::4]:
        missed.append(DOUBLE_PENDULUM.miss(contender.run(setting).centres))
        if missed[-1] < tables.AGREES:
            return
        assert len(missed) < 6, missed


@pytest.mark.slow
@pytest.mark.parametrize("code", sorted({contender.code for contender in ALL}))
def test_every_code_solves_the_chain(code: str) -> None:
    """The first method of each, at a setting that its explicit methods are stable at."""
    contender = next(each for each in contenders(CHAIN)[0] if each.code == code)
    setting = 800.0 if contender.ladder[0] >= 1 else 1e-4
    outcome = contender.run(setting)
    assert CHAIN.miss(outcome.centres) < tables.AGREES
    assert outcome.cpu > 0


def _curve(*points: tuple[float, float], code: str = "mbdkit") -> Curve:
    never: Callable[[float], Any] = lambda setting: None  # noqa: E731
    contender = Contender(code, "method", never, tuple(map(float, range(1, len(points) + 1))))
    return Curve(contender, [Point(float(k), error, cpu=[seconds]) for k, (error, seconds) in enumerate(points, 1)])


def test_a_time_lies_on_the_line_between_neighbours_in_logarithms() -> None:
    curve = _curve((1e-2, 1.0), (1e-4, 4.0), (1e-8, 16.0))
    assert curve.time_at(1e-3) == pytest.approx(2.0)
    assert curve.time_at(1e-6) == pytest.approx(8.0)
    assert curve.time_at(1e-4) == pytest.approx(4.0)


def test_nothing_is_extrapolated() -> None:
    curve = _curve((1e-5, 1.0), (1e-8, 2.0))
    assert curve.time_at(1e-3) == 1.0  # the coarsest setting does
    assert curve.time_at(1e-9) is None


def test_an_error_that_is_small_by_luck_does_not_count() -> None:
    curve = _curve((1e-2, 1.0), (1e-9, 2.0), (1e-4, 4.0), (1e-6, 8.0), (1e-10, 16.0), (1e-9, 32.0))
    assert curve.time_at(1e-6) == pytest.approx(8.0)
    assert curve.time_at(1e-10) == pytest.approx(16.0)


def test_a_finer_setting_that_is_faster_stands_for_coarser_ones() -> None:
    curve = _curve((1e-2, 8.0), (1e-4, 2.0), (1e-6, 4.0))
    assert curve.time_at(1e-3) == pytest.approx(2.0)


def test_settings_that_do_not_get_to_the_end_are_left_out() -> None:
    curve = _curve((math.nan, 0.1), (1e-4, 2.0), (1e-6, 4.0))
    assert curve.time_at(1e-3) == 2.0
    assert _curve((math.nan, 0.1), (math.nan, 0.2)).time_at(1e-3) is None


def test_a_climb_ends_at_round_off() -> None:
    errors = iter([1.0, 1e-4, 1e-8, 2e-8, 3e-8, 4e-8, 5e-8, 6e-8])

    def run(setting: float) -> Outcome:
        centres: Array = np.array(DOUBLE_PENDULUM.rods.centres(np.zeros(2)))
        return Outcome(1e-3, 1e-3, centres * 0 + _shifted(next(errors)))

    curve = climb(Contender("other", "method", run, tuple(map(float, range(1, 9)))), DOUBLE_PENDULUM)
    assert [point.error for point in curve.points] == pytest.approx([1.0, 1e-4, 1e-8, 2e-8, 3e-8, 4e-8, 5e-8], rel=1e-6)


def _shifted(error: float) -> Array:
    from tests.benchmarks.precision.motions import reference

    return reference(DOUBLE_PENDULUM) + np.array([error, 0.0])


def test_a_verdict_compares_the_best_of_both_sides() -> None:
    curves = [
        _curve((1e-2, 1.0), (1e-10, 1.0)),
        _curve((1e-2, 9.0), (1e-10, 9.0)),
        _curve((1e-2, 7.0), (1e-10, 7.0), code="Exudyn"),
        _curve((1e-2, 8.0), (1e-10, 8.0), code="SciPy"),
    ]
    assert tables.ratio(curves, 1e-6) == pytest.approx(7.0)
    assert tables.verdict(curves, 1e-6, 5.0).endswith("7.0 times faster; the goal of 5 times is met")
    assert tables.verdict(curves, 1e-9, 10.0).endswith("the goal of 10 times is MISSED")
