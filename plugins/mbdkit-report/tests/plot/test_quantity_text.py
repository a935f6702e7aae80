from __future__ import annotations

import math

import pytest

from mbdkit_report.figures.quantity_text import count, duration, length, proportion


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1.234, "1.23 m"), (0.9999, "1 m"), (0.0125, "12.5 mm"), (7.87e-6, "7.87 \u00b5m"), (3.1e-9, "3.1 nm"),
        (1.36e-14, "1.4e-14 m"), (0.0, "0 m"), (math.nan, "not finite"),
    ],
)  # fmt: skip
def test_a_length_comes_in_the_unit_that_suits_it(value, words):
    assert length(value) == words


def test_times_proportions_and_counts_read_well():
    assert [duration(value) for value in (75.0, 0.00921, 1.15e-5)] == ["75 s", "9.21 ms", "11.5 \u00b5s"]
    assert [proportion(value) for value in (0.173, 0.0012, 3e-7)] == ["17 %", "0.12 %", "3e-07"]
    assert [count(1, "body", "bodies"), count(12_000, "step")] == ["1 body", "12,000 steps"]
