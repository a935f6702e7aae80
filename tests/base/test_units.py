"""Units: what a text means in SI units, and what is refused."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest

from mbdkit import SpecError
from mbdkit.base.units import read_unit, si_unit


@pytest.mark.parametrize(
    ("text", "same", "factor"),
    [
        ("N", "kg m/s^2", 1.0),
        ("N m", "J", 1.0),
        ("J/s", "W", 1.0),
        ("kN*mm", "N m", 1.0),
        ("mm/s**2", "m/s^2", 1e-3),
        ("deg", "rad", math.pi / 180),
        ("1/s", "Hz", 1.0),
        ("%", "1", 0.01),
        ("N s/m", "kg/s", 1.0),
        ("g", "kg", 1e-3),
        ("m^-1", "1/m", 1.0),
    ],
)
def test_a_text_is_read_as_a_physicist_reads_it(text: str, same: str, factor: float) -> None:
    unit, other = read_unit(text), read_unit(same)
    assert unit.is_like(other)
    assert unit.factor / other.factor == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("text", ["", " ", "N//m", "N/", "/s", "Nm", "N^", "N m^x", "3 N", "N^99 N^99", "N,m"])
def test_what_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(SpecError, match=r"unit|exponent"):
        read_unit(text)


@pytest.mark.parametrize(
    "text", ["N", "J", "W", "m/s^2", "kg/s", "1", "N/m", "N s", "m^2", "1/s", "m kg^2/s^5", "N^2 m^2"]
)
def test_the_name_of_a_unit_is_read_back(text: str) -> None:
    unit = read_unit(text)
    assert si_unit(unit.exponents).is_like(read_unit(si_unit(unit.exponents).text))


def test_a_root_has_a_broken_exponent() -> None:
    assert read_unit("1").times(read_unit("m"), Fraction(1, 2)).text == "m^(1/2)"
