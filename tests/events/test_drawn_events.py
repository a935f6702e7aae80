"""Drawn runs: no event is lost, none is invented, and every run ends where it should."""

from __future__ import annotations

import pytest

from .drawn_events import draw_case


def faults(numbers: range) -> list[str]:
    """Run the cases with these numbers; return what is wrong with them."""
    return [f"case {number}: {fault}" for number in numbers for fault in draw_case(number).faults()]


def test_drawn_events_are_those_of_the_exact_motion() -> None:
    assert faults(range(12)) == []


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 3000, 100))
def test_many_drawn_events_are_those_of_the_exact_motion(first: int) -> None:
    assert faults(range(first, first + 100)) == []
