"""Gaps, slips and their derivatives of rigid contacts in a state, by the kernels of steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbdkit_contact.kernels.kinematics import Shapes, choose, find_gaps, place, row_of


class ContactRows(NamedTuple):
    """Quantities of C contacts: gap [m], slip [m/s], right-hand sides of the constraints on accelerations (C,), and
    derivatives (C, n) of the rates of gaps and slips with respect to the velocities.
    """

    gap: np.ndarray
    slip: np.ndarray
    normal_right: np.ndarray
    tangent_right: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray


def rows_in(shapes: Shapes, q: np.ndarray, v: np.ndarray) -> ContactRows:
    """Return the quantities of all contacts in a state."""
    values, gradients = np.zeros((len(shapes.contacts), 16)), np.zeros((2, len(shapes.contacts), len(q) + 3))
    place(shapes, q, v)
    for pair in range(len(shapes.pairs)):
        choose(shapes, pair)
    for i, (first, second) in enumerate(shapes.contacts[:, :2].tolist()):
        row_of(shapes, i, values[i])
        for own, begin in zip(gradients, (2, 8), strict=True):
            own[i, 3 * first : 3 * first + 3] = values[i, begin : begin + 3]
            own[i, 3 * second : 3 * second + 3] = values[i, begin + 3 : begin + 6]
    normal, tangent = gradients[:, :, : len(q)]
    return ContactRows(*values[:, [0, 1, 14, 15]].T, normal, tangent)


def gaps_in(shapes: Shapes, q: np.ndarray, within: float) -> np.ndarray:
    """Return the gaps (C,) at positions; above `within`, they may be lower bounds that are above it too."""
    gaps = np.zeros(len(shapes.contacts))
    place(shapes, q, q)
    find_gaps(shapes, within, gaps)
    return gaps
