"""The tabulated spring: force over length as a cubic spline through given points, plus a linear damper."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from mbdkit.base.errors import SpecError
from mbdkit.base.strict_model import StrictModel
from mbdkit.base.traced_numbers import cubic_pieces
from mbdkit.mechanism.force_law import FunctionLaw
from mbdkit.mechanism.values import NotNegative, Number, columns_of


def _columns(value: object) -> object:
    return columns_of(value, at="lengths", of="forces", shown="length, force")


class TableOptions(StrictModel):
    """Options of `table`: a spring whose force over its length is given by points, and a linear damper.

    The force is the cubic spline through the points, with the not-a-knot condition at both ends (a parabola for three
    points, a straight line for two). Beyond each end of the table, the force is extrapolated linearly. A
    run that leaves the table is judged doubtful.
    """

    table: Annotated[
        tuple[tuple[Number, ...], tuple[Number, ...]],
        BeforeValidator(_columns),
        Field(json_schema_extra={"examples": [[[0.0, 0.1, 0.3], [0.0, 20.0, 90.0]]]}),
    ]
    """Lengths, angles or coordinates [m or rad], strictly increasing, and the force at each [N or N m], positive if it
    pulls: ``[[length, ...], [force, ...]]``."""
    damping: NotNegative = 0.0
    """Damping [N s/m or N m s/rad]."""


def law(length: float, rate: float, time: float, parameters: Any) -> tuple[float, float, float, float]:
    """Return the force, its derivatives with respect to length and rate, and the potential.

    The potential is zero at the first length of the table. `parameters` contains the damping, the number n of pieces,
    the n + 1 lengths, and five numbers for each piece: its coefficients in ascending powers of the length from the
    beginning of the piece, and the potential there.
    """
    damping, pieces = parameters[0], int(parameters[1])
    low, high = 0, pieces
    while high - low > 1:
        middle = (low + high) // 2
        if parameters[2 + middle] <= length:
            low = middle
        else:
            high = middle
    begin, end = parameters[2 + low], parameters[3 + low]
    # The length within the table; `beyond` is the remainder, over which the force is extrapolated linearly.
    inside = min(max(length, begin), end)
    x, beyond = inside - begin, length - inside
    row = 3 + pieces + 5 * low  # elements one by one, because kernels with derivatives have no slices
    c0, c1, c2, c3 = parameters[row], parameters[row + 1], parameters[row + 2], parameters[row + 3]
    force = c0 + x * (c1 + x * (c2 + x * c3))
    slope = c1 + x * (2.0 * c2 + x * 3.0 * c3)
    potential = parameters[row + 4] + x * (c0 + x * (c1 / 2.0 + x * (c2 / 3.0 + x * c3 / 4.0)))
    potential += beyond * (force + 0.5 * beyond * slope)
    return force + slope * beyond + damping * rate, slope, damping, potential


def parameters(options: TableOptions) -> list[float]:
    """Return the parameters of `law`, in the order in which it reads them."""
    lengths, forces = options.table
    try:
        pieces = cubic_pieces(lengths, forces)
    except (FloatingPointError, ValueError, np.linalg.LinAlgError):
        raise SpecError(
            "the cubic spline through these points cannot be computed in double precision", key="table"
        ) from None
    return [options.damping, float(len(lengths) - 1), *lengths, *pieces]


def valid_range(options: TableOptions) -> dict[str, tuple[float, float]]:
    """Return the range of lengths that the table covers."""
    lengths = options.table[0]
    return {"length": (lengths[0], lengths[-1])}


LAW = FunctionLaw(law, potential=True, passive=True, parameters=parameters, valid_range=valid_range)
