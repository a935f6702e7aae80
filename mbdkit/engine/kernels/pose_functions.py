"""Constraints that are functions of the pose of the second body in the frame of the first: their values.

The laws of such functions are programs (`mbdkit.engine.kernels.law_programs.run_function`), which write the value and
the derivatives with respect to x, y, the relative angle, the angle of the first body, and time. Constraint rows and
their tangents follow from these in `mbdkit.engine.kernels.element_kernels`.
"""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.applied_forces import evaluate_law
from mbdkit.engine.kernels.table_rows import FUNCTION, LAW_ROW
from mbdkit.engine.native.arithmetic import is_lanes, is_refused, put_in_place
from mbdkit.engine.native.functions import inlined, overload, subkernel

#: Numbers that the two laws of a function write: value with first and second derivatives; third derivatives.
VALUES, THIRD = 21, 35
VALUE_ROWS = VALUES // 3
ROWS = VALUE_ROWS + (THIRD + 2) // 3  #: Rows of ``Scratch.u`` of a function.
OF_TIME = 4  #: Claim (`LawRow.claims`) of a function that depends on the time, so that its constraint does work.
POSE = 4  #: Number of parameters of the laws that hold the pose; they come before the parameters of the function.


@inlined
def _write(top, w, law, row, q):
    # the law writes all its results from this row on, and the length of a row gives the address
    evaluate_law(top, w, law, 0.0 * w.cs[0, 0], 0.0, w.time[0], w.u, row, 3)


@inlined
def _write_values_in_lanes(top, w, law, row, q):
    evaluate_law(top, w, law, 0.0 * w.cs[0, 0], 0.0, w.time[0], w.u, row, 21)


@inlined
def _write_third_in_lanes(top, w, law, row, q):
    evaluate_law(top, w, law, 0.0 * w.cs[0, 0], 0.0, w.time[0], w.u, row, 35)


def write_values(top, w, law, row, q):
    """Write the value and the first two derivatives of a function into ``w.u`` from row `row` on."""
    _write(top, w, law, row, q)


def write_third(top, w, law, row, q):
    """Write the third derivatives of a function into ``w.u`` from row `row` on."""
    _write(top, w, law, row, q)


@overload(write_values)
def _write_values(top, w, law, row, q):
    write = _write_values_in_lanes if is_lanes(q) else _write
    return lambda top, w, law, row, q: write(top, w, law, row, q)


@overload(write_third)
def _write_third(top, w, law, row, q):
    write = _write_third_in_lanes if is_lanes(q) else _write
    return lambda top, w, law, row, q: write(top, w, law, row, q)


@subkernel
def evaluate_functions(top, w, q):
    """Evaluate all functions with their first two derivatives into ``w.u``; requires cosines, sines and ``w.time``."""
    for k in range(len(top.functions)):
        a, b = top.functions[k, FUNCTION.first], top.functions[k, FUNCTION.second]
        pair, law, row = top.functions[k, FUNCTION.pair], top.functions[k, FUNCTION.law], top.functions[k, FUNCTION.row]
        ca, sa, cb, sb = w.cs[a, 0], w.cs[a, 1], w.cs[b, 0], w.cs[b, 1]
        px, py = top.pair_parameters[pair, 2], top.pair_parameters[pair, 3]
        bx, by = cb * px - sb * py, sb * px + cb * py
        gx, gy = q[3 * b] + bx - q[3 * a], q[3 * b + 1] + by - q[3 * a + 1]
        place = top.laws[law, LAW_ROW.parameters] + 1
        put_in_place(w.law_values, place, ca * gx + sa * gy - top.pair_parameters[pair, 0])
        put_in_place(w.law_values, place + 1, ca * gy - sa * gx - top.pair_parameters[pair, 1])
        put_in_place(w.law_values, place + 2, q[3 * b + 2] - q[3 * a + 2])
        put_in_place(w.law_values, place + 3, q[3 * a + 2])
        write_values(top, w, law, row, q)
        if is_refused(abs(w.u[row, 0]) < np.inf):
            w.faulty[0] = law


@subkernel
def evaluate_third_derivatives(top, w, q):
    """Evaluate the third derivatives of all functions into ``w.u``; requires `evaluate_functions`."""
    for k in range(len(top.functions)):
        law, row = top.functions[k, FUNCTION.law] + 1, top.functions[k, FUNCTION.row] + VALUE_ROWS
        write_third(top, w, law, row, q)
