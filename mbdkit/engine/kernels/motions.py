"""Prescribed motions u(t), and functions of relative angles: postfix programs, evaluated with their derivatives.

Each stack entry is a jet: value, first and second derivative with respect to the argument. Jets are computed by the
rules of the table of operations (`mbdkit.expressions.operations`), so that the derivatives are exact up to rounding
errors. Jets are used instead of symbolic derivatives because they need no SymPy at run time, and a new expression
requires no compilation. A table is a single instruction, a piecewise polynomial, whose data follow the constants of all
programs in `values`.

The programs of the centers that move with an angle come after those of the motions. Each center has four programs: x,
the derivative of x, y, and the derivative of y. The second derivatives of the programs of derivatives are third
derivatives, which tangents need.
"""

from __future__ import annotations

from mbdkit.engine.kernels.bundle_types import IntVector, RealCube, RealMatrix, RealVector
from mbdkit.engine.native.arithmetic import is_lanes, number_in, put_in
from mbdkit.engine.native.functions import kernel, overload, subkernel
from mbdkit.engine.native.levels import WIDTH
from mbdkit.engine.native.operation_rules import chosen_rule, compiled_rule
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.program import MAX_DEPTH

_BINARY = [one for one in OPERATIONS.values() if one.arity == 2]
_UNARY = [one for one in OPERATIONS.values() if one.arity == 1]
#: Code of each instruction; instructions with two operands come before those with one.
OPCODES = {name: code for code, name in enumerate(("const", "t", "table", *(one.name for one in (*_BINARY, *_UNARY))))}
OF_CENTER = 4  #: Number of programs of a center.

_CONST, _T, _TABLE, _POWI = (OPCODES[name] for name in ("const", "t", "table", "powi"))
_FIRST_UNARY = 3 + len(_BINARY)
_unary = chosen_rule([(OPCODES[one.name], one) for one in _UNARY if one.name != "powi"])
_binary = chosen_rule([(OPCODES[one.name], one) for one in _BINARY])
_power = compiled_rule(OPERATIONS["powi"])


@subkernel
def _piecewise_polynomial(t, values, start):
    """Return the jet of a piecewise polynomial at `t`; the first and last pieces extrapolate it unless it is periodic.

    Starting at index `start`, `values` holds the number of pieces n, the number m of coefficients of a piece, the
    period or 0, the n + 1 end times of the pieces, and for each piece m coefficients in ascending powers of the time
    since its beginning. The piece is found by bisection. Its value and derivatives are computed by Horner's rule.
    """
    pieces, terms, period = int(values[start]), int(values[start + 1]), values[start + 2]
    first = start + 3
    if period > 0.0:
        t = values[first] + (t - values[first]) % period  # as SciPy does, with the same rounding
    # bisection; before the first and after the last piece it ends at that piece, which extrapolates
    low, high = 0, pieces
    while high - low > 1:
        middle = (low + high) // 2
        if values[first + middle] <= t:
            low = middle
        else:
            high = middle
    x = t - values[first + low]
    c = first + pieces + 1 + terms * low
    # three Horner schemes in one loop, each without the terms that its derivative removes
    value, rate, acceleration = 0.0, 0.0, 0.0
    for k in range(terms - 1, -1, -1):
        value = value * x + values[c + k]
        if k >= 1:
            rate = rate * x + k * values[c + k]
        if k >= 2:
            acceleration = acceleration * x + k * (k - 1) * values[c + k]
    return value, rate, acceleration


@subkernel
def _evaluate(i, t, ptr, ops, values, stack, u):
    """Evaluate program `i` at the argument `t`; the other arguments are those of `evaluate_motions`."""
    top = 0
    for j in range(ptr[i], ptr[i + 1]):
        op = ops[j]
        if op == _CONST:
            stack[top, 0], stack[top, 1], stack[top, 2] = values[j], 0.0, 0.0
            top += 1
        elif op == _T:
            stack[top, 0], stack[top, 1], stack[top, 2] = t, 1.0, 0.0
            top += 1
        elif op == _TABLE:
            stack[top, 0], stack[top, 1], stack[top, 2] = _piecewise_polynomial(t, values, int(values[j]))
            top += 1
        elif op < _FIRST_UNARY:
            top -= 1
            a, b = stack[top - 1], stack[top]
            a[0], a[1], a[2] = _binary(op, a[0], a[1], a[2], b[0], b[1], b[2])
        else:
            a = stack[top - 1]
            if op == _POWI:
                f, d1, d2 = _power(a[0], values[j])
            else:
                f, d1, d2 = _unary(op, a[0])
            # chain rule: (f(a))' = f' a' and (f(a))'' = f'' a'^2 + f' a''
            a[0], a[1], a[2] = f, d1 * a[1], d2 * a[1] * a[1] + d1 * a[2]
    u[i, 0], u[i, 1], u[i, 2] = stack[0, 0], stack[0, 1], stack[0, 2]


@subkernel
def evaluate_motions(t, count, ptr, ops, values, stack, u):
    """Evaluate the first `count` programs at time `t`.

    Parameters
    ----------
    t : float
        Time [s].
    count : int
        Number of motions.
    ptr, ops, values
        Program i is ``ops[ptr[i]:ptr[i+1]]``, with one constant per instruction at the same index of `values`. The
        constant of a table is the index in `values` at which its data begin.
    stack : (MAX_DEPTH, 3) array
        Scratch.
    u : (motions, 3) array
        Receives value, first and second derivative with respect to time.
    """
    for i in range(count):
        _evaluate(i, t, ptr, ops, values, stack, u)


@subkernel
def _motions_in_lanes(t, count, ptr, ops, values, stack, u):
    """Evaluate every motion for one lane after another; `values` are (WIDTH, N), `stack` (MAX_DEPTH + motions, 3)."""
    results = stack[MAX_DEPTH:]
    for lane in range(WIDTH if count > 0 else 0):
        evaluate_motions(number_in(t, lane), count, ptr, ops, values[lane], stack, results)
        for m in range(count):
            for i in range(3):
                u[m, i] = put_in(u[m, i], lane, results[m, i])


def motions(t, count, ptr, ops, values, stack, u):
    """Evaluate every motion at time `t`, for one run or in lanes; see `evaluate_motions`."""
    evaluate_motions(t, count, ptr, ops, values, stack, u)


@overload(motions)
def _motions(t, count, ptr, ops, values, stack, u):
    evaluate = _motions_in_lanes if is_lanes(t) else evaluate_motions
    return lambda t, count, ptr, ops, values, stack, u: evaluate(t, count, ptr, ops, values, stack, u)


@subkernel
def _center(angle, first, ptr, ops, values, stack, u):
    """Evaluate the programs of the center that begin with program `first`, at a relative angle [rad]."""
    for i in range(first, first + OF_CENTER):
        _evaluate(i, angle, ptr, ops, values, stack, u)


@subkernel
def _centers_one_by_one(q, bodies, ptr, ops, values, stack, u):
    """Evaluate the centers of one run; see `centers`."""
    first = len(ptr) - 1 - OF_CENTER * len(bodies)
    for c in range(len(bodies)):
        angle = q[3 * bodies[c, 1] + 2] - q[3 * bodies[c, 0] + 2]
        _center(angle, first + OF_CENTER * c, ptr, ops, values, stack, u)


@subkernel
def _centers_in_lanes(q, bodies, ptr, ops, values, stack, u):
    """Evaluate the centers for one lane after another; see `_motions_in_lanes`."""
    results = stack[MAX_DEPTH:]
    begin = len(ptr) - 1 - OF_CENTER * len(bodies)
    for c in range(len(bodies)):
        first = begin + OF_CENTER * c
        for lane in range(WIDTH):
            angle = number_in(q[3 * bodies[c, 1] + 2], lane) - number_in(q[3 * bodies[c, 0] + 2], lane)
            _center(angle, first, ptr, ops, values[lane], stack, results)
            for m in range(first, first + OF_CENTER):
                for i in range(3):
                    u[m, i] = put_in(u[m, i], lane, results[m, i])


def centers(q, bodies, ptr, ops, values, stack, u):
    """Evaluate the centers that move with the angle of the second body relative to the first, for one run or in lanes.

    Parameters
    ----------
    q : (3 (B + 1),) array
        Positions.
    bodies : (C, 2) array
        First and second body of each center.
    ptr, ops, values, stack, u
        See `evaluate_motions`.
    """
    _centers_one_by_one(q, bodies, ptr, ops, values, stack, u)


@overload(centers)
def _centers(q, bodies, ptr, ops, values, stack, u):
    evaluate = _centers_in_lanes if is_lanes(q) else _centers_one_by_one
    return lambda q, bodies, ptr, ops, values, stack, u: evaluate(q, bodies, ptr, ops, values, stack, u)


@kernel
def motions_at(
    times: RealVector, ptr: IntVector, ops: IntVector, values: RealVector, stack: RealMatrix, u: RealCube
) -> None:  # fmt: skip
    """Evaluate every program at `times` (T,) into `u` (T, motions, 3); see `evaluate_motions`."""
    for row in range(len(times)):
        evaluate_motions(times[row], len(ptr) - 1, ptr, ops, values, stack, u[row])
