"""Units of measured quantities: dimensions, SI factors, and reading of texts such as ``N m`` or ``2 N/mm``."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Sequence
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from functools import cache

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.text import did_you_mean, listed

Exponents = tuple[Fraction, Fraction, Fraction]  #: Exponents of metre, kilogram and second.

_NONE: Exponents = (Fraction(0), Fraction(0), Fraction(0))
_BASE = ("m", "kg", "s")
LARGEST_EXPONENT = 99


@dataclass(frozen=True)
class Unit:
    """A unit. Two units can be compared and added if their `exponents` are equal.

    - `text`: the unit as it is shown, such as ``N m``.
    - `exponents`: exponents of metre, kilogram and second. Angles are pure numbers, as in the SI.
    - `factor`: size of the unit in SI units.
    - `counts`: exponents of angle, cycle and percent. In the SI these are pure numbers, but `fits` distinguishes them.
    - `si`: the SI unit of the same kind, such as ``N m/rad`` for ``N mm/deg``.
    """

    text: str
    exponents: Exponents = _NONE
    factor: float = 1.0
    counts: Exponents = _NONE
    si: str = "1"

    def __str__(self) -> str:
        return self.text

    def is_like(self, other: Unit) -> bool:
        """Return whether both units measure the same kind of quantity, such as m and mm."""
        return self.exponents == other.exponents

    def fits(self, wanted: Unit) -> bool:
        """Return whether a number with this unit can be given where a number in the unit `wanted` is expected.

        rad may be left out, as in N m for N m/rad, but 10 Hz and 10 1/min are not angular velocities, and 2 deg is not
        a length.
        """
        counts = zip(self.counts, wanted.counts, strict=True)
        is_cycles_for_angle = self.is_frequency and wanted.counts[0] != 0
        return self.is_like(wanted) and not is_cycles_for_angle and all(one in (0, other) for one, other in counts)

    @property
    def is_frequency(self) -> bool:
        """Whether the unit usually counts cycles per time, as Hz and 1/min do. 1/s may be an angular velocity."""
        length, mass, time = self.exponents
        is_rate = time == -1 and not any((length, mass, *self.counts))
        return (is_rate and self.factor != 1.0) or self.counts[1] != 0

    def times(self, other: Unit, power: Fraction = Fraction(1)) -> Unit:
        """Return the SI unit of the product of a quantity in this unit and a quantity in `other` raised to `power`."""
        a, b = self.exponents, other.exponents
        return si_unit((a[0] + power * b[0], a[1] + power * b[1], a[2] + power * b[2]))


def _exponents(m: int = 0, kg: int = 0, s: int = 0) -> Exponents:
    return Fraction(m), Fraction(kg), Fraction(s)


_FORCE, _ENERGY, _POWER = _exponents(1, 1, -2), _exponents(2, 1, -2), _exponents(2, 1, -3)
_PRESSURE = _exponents(-1, 1, -2)
#: SI factors of the symbols, by their dimension.
_FACTORS: dict[Exponents, dict[str, float]] = {
    _exponents(m=1): {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3, "um": 1e-6},
    _exponents(kg=1): {"kg": 1.0, "g": 1e-3},
    _exponents(s=1): {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    _exponents(s=-1): {"Hz": 1.0},
    _NONE: {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi, "%": 1e-2, "1": 1.0},
    _FORCE: {"N": 1.0, "kN": 1e3, "mN": 1e-3},
    _ENERGY: {"J": 1.0, "kJ": 1e3, "mJ": 1e-3},
    _PRESSURE: {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    _POWER: {"W": 1.0, "kW": 1e3, "mW": 1e-3},
}
#: Exponents and SI factor of each symbol.
_SYMBOLS = {symbol: (of, factor) for of, factors in _FACTORS.items() for symbol, factor in factors.items()}
_COUNTS = {"rad": (1, 0, 0), "mrad": (1, 0, 0), "deg": (1, 0, 0), "rev": (1, 0, 0), "Hz": (0, 1, 0), "%": (0, 0, 1)}
_RPM = re.compile(r"(/\s*)?\brpm\b((?:\^|\*\*)-?\d{1,2}(?:\.5)?)?")
#: SI symbols of the units for which removing the prefix does not give the SI symbol.
_SI = {"kg": "kg", "g": "kg", "min": "s", "Hz": "Hz", "deg": "rad", "rev": "rad", "mrad": "rad", "%": "1"}

#: Usual names of SI units with several base units.
_NAMED = {_NONE: "1", _FORCE: "N", _ENERGY: "J", _POWER: "W", _exponents(1, 1, -1): "N s"}
_NAMED |= {_exponents(0, 1, -2): "N/m", _exponents(0, 1, -1): "N s/m", _exponents(2, 1, -1): "J s"}

NUMBER = r"[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
QUANTITY = rf"^\s*{NUMBER}\s+(?:[A-Za-z%]|1/)[A-Za-z0-9%*/^. -]*$"  #: Pattern of a number with a unit.
PERCENT = rf"^\s*{NUMBER}\s+%$"
_QUANTITY = re.compile(rf"\s*({NUMBER}(?:,[0-9]+)?)(\s*)((?:[A-Za-z%]|1/)[A-Za-z0-9%*/^. -]*)")
_LONGEST = 100
#: The unit of pure numbers, which may also be given in percent.
PLAIN = Unit("1", counts=(Fraction(0), Fraction(0), Fraction(1)))

_PART = re.compile(r"(%|1|[A-Za-z]+)(?:(?:\^|\*\*)(-?\d{1,2}(?:\.5)?))?")


def si_unit(exponents: Exponents) -> Unit:
    """Return the SI unit with these exponents."""
    if (text := _NAMED.get(exponents)) is None:
        length, mass, time = exponents
        parts = list(zip(_BASE, exponents, strict=True))
        if mass > 0 and time == -2 * mass:  # a power of forces, such as N^2 m^2
            parts = [("N", mass), ("m", length - mass)]
        above = [_power(name, e) for name, e in parts if e > 0]
        text = "/".join([" ".join(above) or "1", *[_power(name, -e) for name, e in parts if e < 0]])
    return Unit(text, exponents)


def _power(name: str, exponent: Fraction) -> str:
    shown = f"({exponent})" if exponent.denominator > 1 else str(exponent)
    return name if exponent == 1 else f"{name}^{shown}"


def read_unit(text: str) -> Unit:
    """Parse the text of a unit: symbols with powers in halves such as m^1.5, multiplied by blanks or ``*``, divided
    by ``/``.

    Raises SpecError if the text is not a unit.
    """
    exponents, factor, counts, si = list(_NONE), 1.0, list(_NONE), ""
    sign, position, written = 1, 0, _RPM.sub(_in_revolutions, text.strip())
    if not written:
        raise SpecError("should be a unit such as N, N m, mm or deg, not an empty text")
    while position < len(written):
        if (match := _PART.match(written, position)) is None:
            raise SpecError(f"'{_short(text)}' is not a unit; units are written such as N m, m/s^2, mm or deg")
        symbol, power = match[1], sign * Fraction(match[2] or 1)
        if symbol not in _SYMBOLS:
            apart = (f" (did you mean '{symbol[:i]} {symbol[i:]}'?)" for i in range(1, len(symbol))
                     if symbol[0] == "N" and symbol[:i] in _SYMBOLS and symbol[i:] in _SYMBOLS)  # fmt: skip
            hint = next(apart, "") or did_you_mean(symbol, known := [*_SYMBOLS, "rpm"]) or f"; known: {listed(known)}"
            raise SpecError(f"'{_short(symbol)}' is not a known unit{hint}")
        of_symbol, size = _SYMBOLS[symbol]
        exponents = [total + power * exponent for total, exponent in zip(exponents, of_symbol, strict=True)]
        if any(abs(total) > LARGEST_EXPONENT for total in exponents):
            raise SpecError(f"'{_short(text)}' has an exponent larger than {LARGEST_EXPONENT}")
        factor *= float(size**power)
        counts = [total + power * count for total, count in zip(counts, _COUNTS.get(symbol, (0, 0, 0)), strict=True)]
        plain = symbol[1:] if len(symbol) > 1 and symbol[1:] in _SYMBOLS else symbol
        si += _SI.get(symbol, plain) + written[match.end(1) : match.end()]
        between = re.compile(r"\s*([*/])\s*|\s+|$").match(written, match.end())
        if between is None or (between.end() == len(written) and between[1]):
            raise SpecError(f"'{_short(text)}' is not a unit; units are written such as N m, m/s^2, mm or deg")
        si += written[match.end() : between.end()]
        sign = -1 if between[1] == "/" else 1
        position = between.end()
        if position == match.end():
            break
    of_base, counted = ((x[0], x[1], x[2]) for x in (exponents, counts))
    return Unit(" ".join(text.split()), of_base, factor, counted, " ".join(si.split()))


def _in_revolutions(match: re.Match[str]) -> str:
    """Return the text of a power of rpm in terms of rev/min; the match includes a preceding ``/``."""
    slash, power = match[1] or "", match[2] or ""
    return f"{slash}rev{power}{'*' if slash else '/'}min{power}"


def read_quantity(text: object, names: Container[str] = ()) -> tuple[float, Unit] | None:
    """Return the number in SI units and the unit of a text such as ``2 N/mm``; None if it is not a number with a unit.

    `names`: names that may occur in expressions. A text with such a name in place of a unit is not a number with a
    unit. Raises SpecError if the unit is not known, or not separated from the number.
    """
    if not isinstance(text, str) or len(text) > _LONGEST or (match := _QUANTITY.fullmatch(text)) is None:
        return None
    number, space, written = match.groups()
    try:
        unit = read_unit(written)
    except SpecError as error:
        if not space or any(word in names for word in re.findall(r"\w+", written)):
            return None
        raise SpecError(f"'{_short(text)}' is not a number with a unit: {error.message}") from None
    if "," in number:
        raise SpecError(f"'{_short(text)}' should have a point in place of the decimal comma")
    if not space:
        raise SpecError(f"'{_short(text)}' needs a space between the number and its unit: {number} {written}")
    # decimal arithmetic, so that 35 mm is 0.035 m and not the product of two rounded numbers
    return float(Decimal(number) * Decimal(repr(unit.factor))), unit


def number_in(value: float | str, unit: str) -> float:
    """Return a number, or the SI value of a number with a unit; raise SpecError if its unit does not fit `unit`, or for
    any other text.
    """
    if (quantity := read_quantity(value)) is None:
        if isinstance(value, str):
            raise SpecError(f"should be a number, or a number with a unit such as '1 {unit}', not '{_short(value)}'")
        return float(value)
    if not quantity[1].fits(read_unit(unit)):
        raise SpecError(misfit(_short(str(value)), quantity[1], (unit,)))
    return quantity[0]


def misfit(text: str, unit: Unit, wanted: Sequence[str]) -> str:
    """Return a message about a text whose unit is none of the wanted ones; without these, a number has no unit."""
    takes = f"in {listed(wanted, 'or')}" if wanted else "without a unit"
    hint = ""
    if unit.is_frequency and "rad/s" in wanted:
        hint = f"; if these are revolutions, write {'rev/s' if unit.factor == 1.0 else 'rev/min (or rpm)'}"
    return f"'{text}' has the unit {unit}, but this is a number {takes}{hint}"


@cache
def described_units(description: str) -> tuple[str, ...]:
    """Return the units in a description such as ``Stiffness [N/m]``.

    The units are those in the first brackets that contain only units. There are two in ``[N/m or N m/rad]`` and in
    ``[m, rad]``, and none if there are no such brackets.
    """
    for inside in re.findall(r"\[([^\[\]]+)\]", description):
        units = tuple(re.split(r",? or |, ", inside))
        with suppress(SpecError):
            return tuple(read_unit(unit).text for unit in units)
    return ()


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."
