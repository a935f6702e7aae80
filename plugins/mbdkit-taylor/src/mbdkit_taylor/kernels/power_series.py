"""Taylor coefficients of products, quotients and elementary functions, and of the prescribed motions u(t).

A series is a vector of coefficients of 1, tau, tau^2, ..., where tau is the time since the beginning of a step. Each
coefficient follows from those of lower order by the recurrences of automatic differentiation (Griewank and Walther,
Evaluating Derivatives, 2008, ch. 13).
"""

from __future__ import annotations

import math

from mbdkit.engine.kernels.motions import OPCODES
from mbdkit.engine.kernels.vectors import copy, fill
from mbdkit.engine.native.functions import subkernel

#: Operations whose series are implemented. The others have switches (such as ``abs``), where no series exists, or are
#: too rare.
EXPANDED = ("const", "t", "add", "sub", "mul", "div", "powi", "neg", "sin", "cos", "exp", "log", "sqrt")

_CONST, _T, _ADD, _SUB, _MUL, _DIV, _POWI, _NEG, _SIN, _COS, _EXP, _LOG, _SQRT = (OPCODES[name] for name in EXPANDED)


@subkernel
def coefficient(a, b, k):
    """Return coefficient `k` of the product of two series."""
    total = 0.0
    for j in range(k + 1):
        total += a[j] * b[k - j]
    return total


@subkernel
def _multiply(a, b):
    for k in range(len(a) - 1, -1, -1):
        a[k] = coefficient(a, b, k)


@subkernel
def _divide(a, b):
    for k in range(len(a)):
        total = a[k]
        for j in range(k):
            total -= a[j] * b[k - j]
        a[k] = total / b[0]


@subkernel
def _raise(a, exponent, base):
    """Replace the series `a` by its power with an integer exponent; `base` is a work array."""
    copy(a, base)
    fill(a, 0.0)
    a[0] = 1.0
    for _ in range(int(abs(exponent))):
        _multiply(a, base)
    if exponent < 0.0:
        copy(a, base)
        fill(a, 0.0)
        a[0] = 1.0
        _divide(a, base)


@subkernel
def _turn(a, sine, cosine):
    """Write the series of the sine and the cosine of the series `a` to `sine` and `cosine`."""
    sine[0], cosine[0] = math.sin(a[0]), math.cos(a[0])
    for k in range(1, len(a)):
        s, c = 0.0, 0.0
        for j in range(1, k + 1):
            s += j * a[j] * cosine[k - j]
            c -= j * a[j] * sine[k - j]
        sine[k], cosine[k] = s / k, c / k


@subkernel
def _apply(op, a, old, other):
    """Replace the series `a` by the series of a function of it; `old` and `other` are work arrays."""
    copy(a, old)
    if op == _NEG:
        for k in range(len(a)):
            a[k] = -old[k]
    elif op == _SIN:
        _turn(old, a, other)
    elif op == _COS:
        _turn(old, other, a)
    elif op == _EXP:
        a[0] = math.exp(old[0])
        for k in range(1, len(a)):
            a[k] = 0.0
            for j in range(1, k + 1):
                a[k] += j * old[j] * a[k - j] / k
    elif op == _LOG:
        a[0] = math.log(old[0])
        for k in range(1, len(a)):
            total = old[k]
            for j in range(1, k):
                total -= j * a[j] * old[k - j] / k
            a[k] = total / old[0]
    else:
        a[0] = math.sqrt(old[0])
        for k in range(1, len(a)):
            total = old[k]
            for j in range(1, k):
                total -= a[j] * a[k - j]
            a[k] = total / (2.0 * a[0])


@subkernel
def expand_motions(t, ptr, ops, values, stack, u):
    """Write the series, about the time `t`, of the values of all programs, which consist of `EXPANDED` operations.

    Parameters
    ----------
    t : float
        Time [s].
    ptr, ops, values
        Programs; see `mbdkit.engine.kernels.motions.evaluate_motions`.
    stack : (MAX_DEPTH + 2, K) array
        Work array.
    u : (motions, K) array
        Receives the coefficients.
    """
    old, other = stack[len(stack) - 2], stack[len(stack) - 1]
    for i in range(len(u)):
        top = 0
        for j in range(ptr[i], ptr[i + 1]):
            op = ops[j]
            if op in (_CONST, _T):
                fill(stack[top], 0.0)
                if op == _CONST:
                    stack[top, 0] = values[j]
                else:
                    stack[top, 0] = t
                    stack[top, 1] = 1.0
                top += 1
                continue
            if op in (_ADD, _SUB, _MUL, _DIV):
                top -= 1
                a, b = stack[top - 1], stack[top]
                if op == _MUL:
                    _multiply(a, b)
                elif op == _DIV:
                    _divide(a, b)
                else:
                    sign = 1.0 if op == _ADD else -1.0
                    for k in range(len(a)):
                        a[k] += sign * b[k]
            elif op == _POWI:
                _raise(stack[top - 1], values[j], old)
            else:
                _apply(op, stack[top - 1], old, other)
        copy(stack[0], u[i])
