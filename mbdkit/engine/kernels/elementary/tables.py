"""Tables of powers of two and of logarithms for exp, log and pow.

They are computed when this module is imported, from fixed-point numbers, which are integers divided by 2^128: integers
give the same tables on every machine.
"""

from __future__ import annotations

from math import isqrt

import numpy as np

from mbdkit.engine.kernels.elementary.exact_sums import bits_of, from_bits
from mbdkit.engine.native.functions import placeholder

PARTS_BITS = 7
PARTS = 2**PARTS_BITS  #: Number of entries of each table.
INTERVAL = 52 - PARTS_BITS  #: Last bits of a double, which vary within one interval of the table of logarithms.
#: Bits of the smallest m, about 0.705: one of the intervals begins at 1 - 1/512 and ends at 1 + 1/256.
LEAST_BITS = bits_of(1.0) - (151 << (INTERVAL - 1))
_POINT = 128
_ONE = 1 << _POINT
_LOGARITHM_DIGITS = 42  #: Binary digits of the first part of a logarithm: sums of it and multiples of LN2 are exact.


def _powers_of_two() -> list[float]:
    """Return for each i below `PARTS` 2^(i / PARTS) as a double, and what it lacks, divided by this power."""
    root = 2 * _ONE
    for _ in range(PARTS_BITS):
        root = isqrt(root << _POINT)
    table, power = [], _ONE
    for _ in range(PARTS):
        nearest = power / _ONE
        table += [nearest, (power - int(nearest * 2**52) * (_ONE >> 52)) / power]
        power = power * root >> _POINT
    return table


def _logarithm(x: int) -> int:
    """Return the logarithm of a fixed-point number between 1/2 and 2, which is ``2 atanh((x - 1) / (x + 1))``."""
    s = ((x - _ONE) << _POINT) // (x + _ONE)
    square, total, power, k = s * s >> _POINT, 0, s, 1
    while abs(power) > 1:
        total += power // k
        power, k = power * square >> _POINT, k + 2
    return 2 * total


def _logarithms() -> list[float]:
    """Return for each interval of m a number c of 10 bits with ``c m`` close to 1, and ``-log(c)`` as two numbers."""
    table = []
    for i in range(PARTS):
        low, high = (from_bits(LEAST_BITS + (k << INTERVAL)) for k in (i, i + 1))
        unit = 512 if low < 1.0 else 1024
        c = 1.0 if low < 1.0 < high else round(2.0 * unit / (low + high)) / unit
        logarithm = -_logarithm(int(1024 * c) * (_ONE >> 10))
        first = round(logarithm * 2**_LOGARITHM_DIGITS / _ONE)
        table += [c, first / 2**_LOGARITHM_DIGITS, (logarithm - first * (_ONE >> _LOGARITHM_DIGITS)) / _ONE]
    return table


POWERS_OF_TWO = np.array(_powers_of_two())
LOGARITHMS = np.array(_logarithms())


@placeholder
def entry(table, index):
    """Return the number in a table at an index; for each lane, at its own index."""
    return table.item(index)
