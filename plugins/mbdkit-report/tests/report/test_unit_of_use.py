"""Units of parameters without units, derived from the numbers in which they are used."""

from __future__ import annotations

import pytest

from mbdkit.base.units import read_unit
from mbdkit_report.unit_of_use import unit_of_use

USES: dict[str, tuple[list[tuple[str, str]], str]] = {
    "alone": ([("k", "N m/rad")], "N m/rad"), "share": ([("L/2 + k", "m"), ("-k", "m")], "m"),
    "rate": ([("k*t", "rad")], "rad/s"), "rate in degrees": ([("degrees(k)*t", "rad")], "deg/s"),
    "argument": ([("3.7*sin(k*t)", "N m")], "rad/s"), "frequency": ([("F*sin(2*pi*k*t)", "N")], "Hz"),
    "amplitude": ([("k*sin(2*pi*f*t)", "N")], "N"), "speed": ([("0.1 + k*t", "m")], "m/s"),
    "with a parameter": ([("k*L", "N m")], "N"), "denominator": ([("L/k", "m/s")], "s"),
    "constant of nature": ([("9.81*k", "N")], ""), "contradiction": ([("k", "m"), ("k", "kg")], ""),
    "power": ([("k**2", "m^2")], ""), "two units": ([("k", "N or N m")], ""), "other parameter": ([("L", "m")], ""),
}  # fmt: skip


@pytest.mark.parametrize(("uses", "unit"), USES.values(), ids=USES)
def test_the_unit_of_a_parameter_follows_from_its_uses(uses: list[tuple[str, str]], unit: str) -> None:
    assert unit_of_use("k", uses, {"L": read_unit("m"), "f": read_unit("Hz")}) == unit
