"""Finding changes of sign within one step, on functions whose zeros are known."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from mbdkit.events.crossing import UndefinedError, crossings
from mbdkit.events.watch import INSIDE
from tests.margins import assert_within

PLACES = (0.0, *INSIDE, 1.0)


def found(function: Callable[[float], float], before: int = 0, dense: Callable[[float], float] | None = None):
    """Return places and directions of the crossings of a function, and the sign after it."""
    seen = dense or function
    shown = [(x, function(x) if x in (0.0, 1.0) else seen(x)) for x in PLACES]
    places, now = crossings(before, shown, seen, function, 1e-14)
    return [(place.theta, place.direction) for place in places], now


@pytest.mark.parametrize("root", [1e-6, 0.3, 0.25, 0.5, 0.9999999])
def test_a_simple_zero_is_located_to_the_accuracy_that_is_asked_for(root: float) -> None:
    [(place, direction)], now = found(lambda x: math.exp(x) - math.exp(root), before=-1)
    assert_within(place - root, 1e-13)
    assert (direction, now) == (1, 1)


@pytest.mark.parametrize("roots", [(0.4, 0.6), (0.3, 0.34), (0.02, 0.09), (0.93, 0.98)])
def test_a_scalar_that_crosses_there_and_back_within_a_step_is_found(roots: tuple[float, float]) -> None:
    places, now = found(lambda x: (x - roots[0]) * (x - roots[1]), before=1)
    assert [direction for _, direction in places] == [-1, 1]
    assert [place for place, _ in places] == pytest.approx(roots, abs=1e-13)
    assert now == 1


def test_what_dense_output_shows_and_the_method_does_not_is_no_crossing() -> None:
    places, now = found(lambda x: 0.1 + x, before=1, dense=lambda x: 0.1 + x - 3 * x * (1 - x))
    assert (places, now) == ([], 1)


def test_a_zero_that_is_touched_is_no_crossing() -> None:
    assert found(lambda x: (x - 0.5) ** 2, before=1) == ([], 1)
    assert found(lambda x: x**2, before=1) == ([], 1)


def test_a_zero_at_the_start_of_the_run_is_no_crossing() -> None:
    assert found(lambda x: x, before=0) == ([], 1)


def test_a_zero_that_a_step_ends_on_counts_where_the_other_side_is_reached() -> None:
    assert found(lambda x: x - 1.0, before=-1) == ([], -1)
    assert found(lambda x: x, before=-1) == ([(0.0, 1)], 1)
    assert found(lambda x: -x, before=-1) == ([], -1)


def test_a_scalar_that_rests_at_zero_crosses_where_it_leaves_to_the_other_side() -> None:
    [(place, direction)], _ = found(lambda x: max(0.0, x - 0.6), before=-1)
    assert place == pytest.approx(0.6, abs=1e-13)
    assert direction == 1


def test_a_jump_to_the_other_side_is_a_crossing_and_a_pole_is_none() -> None:
    [(place, direction)], _ = found(lambda x: -2.0 if x < 0.7 else 5.0, before=-1)
    assert place == pytest.approx(0.7, abs=1e-13)
    assert direction == 1
    assert found(lambda x: 1.0 / (x - 0.437), before=-1) == ([], 1)


@pytest.mark.parametrize("power", [3, 5, 9, 21, 101])
@pytest.mark.parametrize("root", [0.3, 0.7123])
def test_an_odd_multiple_zero_is_located_with_few_evaluations(power: int, root: float) -> None:
    evaluations: list[float] = []

    def function(x: float) -> float:
        evaluations.append(x)
        return (x - root) ** power

    [(place, direction)], _ = found(function, before=-1)
    # expected: the last position at which the power is not positive; it underflows close to the zero
    last = root + 5e-324 ** (1 / power)
    assert place == pytest.approx(last, abs=0.1 * abs(last - root) + 1e-13)
    assert direction == 1
    assert len(evaluations) < 70


def test_the_zero_of_rounding_errors_is_located() -> None:
    [(place, direction)], _ = found(lambda x: ((x - 1.5) * x + 0.75) * x - 0.125, before=-1)  # (x - 1/2)^3
    assert place == pytest.approx(0.5, abs=1e-4)
    assert direction == 1


def test_a_jump_at_the_start_of_a_step_is_a_crossing() -> None:
    assert found(lambda x: x - 2.0, before=1) == ([(0.0, -1)], -1)
    [first, (place, direction)], now = found(lambda x: x - 0.3, before=1)
    assert first == (0.0, -1)
    assert place == pytest.approx(0.3, abs=1e-13)
    assert (direction, now) == (1, 1)


def test_a_pole_at_an_end_of_a_step_is_no_crossing() -> None:
    def reciprocal(x: float) -> float:
        return 1.0 / x if x else math.nan

    assert found(lambda x: reciprocal(x - 1.0), before=-1) == ([], -1)
    assert found(reciprocal, before=-1) == ([], 1)
    assert found(lambda x: reciprocal(x) ** 2, before=1) == ([], 1)
    for pole in (1e-15, 1.0 - 1e-15):  # beside the end by rounding errors
        assert found(lambda x, pole=pole: reciprocal(x - pole), before=-1) == ([], 1)


def test_a_jump_at_the_end_of_a_step_without_a_value_is_a_crossing() -> None:
    def steps(x: float) -> float:
        return math.copysign(2.0, x) if x else math.nan

    assert found(steps, before=-1) == ([(0.0, 1)], 1)


def test_a_scalar_without_a_value_is_an_error() -> None:
    with pytest.raises(UndefinedError):
        found(lambda x: math.nan if x > 0.9 else 1.0, before=1)
