"""Times at which operations of functions of time switch, or their operands have zeros or extrema.

The arguments of ``abs``, ``min``, ``max`` and ``atan2`` are sampled over the span of the run, at `SAMPLES` times and at
all corners of nested functions. Changes of sign between two samples are located by bisection. If two samples have equal
signs, but the rates at them indicate an extremum towards zero in between, the extremum is located first. Two changes of
sign are therefore missed only if there is more than one extremum between the two samples.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from mbdkit.expressions.jets import EPS, Jet, jet_and_switches
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.program import Program, execute

SAMPLES = 10_000  #: Number of samples over the span of a run; fewer for long expressions.

MOST_OPERATIONS = 50_000_000  #: Largest number of operations that one sampling of an argument may take.

BISECTIONS = 80  #: Number of bisections; sufficient to reduce any interval to adjacent floating-point numbers.

#: Operations that may have a corner, a pole, or a feature far shorter than those of their operand, such as the pulse
#: ``exp(-(t/1e-6)**2)``, at zeros and extrema of the operand: of the denominator, the base, or, for ``tan``, its
#: cosine.
SHARP = frozenset({"div", "pow", "powi", "tan", "asin", "acos", "atan", "exp", "log", "sqrt", "tanh"})
#: Integer exponents up to this one, from 0 on, lead to no features shorter than those of the base.
LARGEST_POWER = 8
MANY_ZEROS = 100  #: If this many samples of an operand are zero, it is constant there, and they are no seeds.


@lru_cache(maxsize=256)
def sharp_operands(program: Program) -> tuple[Program, ...]:
    """Return the operands of sharp operations, inner ones first: functions at whose zeros and extrema seeds lie."""
    operands: dict[Program, None] = {}

    def step(operation: str, number: float, *given: Program) -> Program:
        if operation in SHARP and not (operation == "powi" and 0 <= number <= LARGEST_POWER):
            operand = given[1] if operation == "div" else given[0]
            operands.setdefault((*operand, ("cos", 0.0)) if operation == "tan" else operand)
        return (*(instruction for operand in given for instruction in operand), (operation, number))

    execute(program, step)
    return tuple(operand for operand in operands if ("t", 0.0) in operand)


def seeds_of(program: Program, start: float, end: float, looks: int) -> list[float]:
    """Return the times in a run at which operands of sharp operations have zeros or extrema, or operations switch.

    `looks`: number of samples over the span.
    """
    close = 64.0 * EPS * max(abs(start), abs(end))
    has_switches = any(name in OPERATIONS and OPERATIONS[name].switch for name, _ in program)
    result = np.array([time for time, _ in switching_times(program, start, end)] if has_switches else [])
    for operand in sharp_operands(program):
        for which in ("rate", "value"):  # between two zeros of the value, its rate has one

            def at(times: np.ndarray, operand: Program = operand, which: str = which) -> np.ndarray:
                return np.asarray(getattr(jet_and_switches(operand, times)[0], which))

            times = np.union1d(np.linspace(start, end, looks), result)
            signs = np.sign(at(times))
            crossed = np.flatnonzero(signs[:-1] * signs[1:] < 0.0)
            exact = times[signs == 0.0] if np.sum(signs == 0.0) < MANY_ZEROS else times[:0]
            result = np.concatenate([result, exact, _bisected(at, times[crossed], times[crossed + 1])])
    result = np.sort(result[(result > start + close) & (result < end - close)])
    return [*result[np.diff(result, prepend=-np.inf) > close].tolist()]


@lru_cache(maxsize=64)
def switching_times(program: Program, start: float, end: float, samples: int = SAMPLES) -> list[tuple[float, float]]:
    """Return the times [s] at which operations of a program switch between their operands, with their rounding errors.

    Switches whose argument is not finite are left out.

    `program`: a function of time. `start`, `end`: the span that is searched [s]. `samples`: number of samples over the
    span; fewer are taken of long programs.
    """
    times = np.linspace(start, end, max(1000, min(samples, MOST_OPERATIONS // len(program))) + 1)
    values: dict[float, float] = {}
    level = 0
    while True:
        level += 1
        _, switches = jet_and_switches(program, times)
        new: dict[float, float] = {}
        for number, switch in enumerate(switches):
            if switch.level == level:
                new.update(_changes(_argument_of(program, number), times, switch.argument))
        values.update(new)
        if level >= max((switch.level for switch in switches), default=0):
            return sorted(values.items())
        times = np.unique(np.concatenate([times, list(new)]))


def _argument_of(program: Program, number: int) -> Callable[[np.ndarray], Jet]:
    """Return the argument of a switch as a function of times (T,)."""
    return lambda times: jet_and_switches(program, times)[1][number].argument


def _changes(argument: Callable[[np.ndarray], Jet], times: np.ndarray, sampled: Jet) -> dict[float, float]:
    """Return the times at which an argument changes its sign, each with its rounding error [s]."""
    known = np.isfinite(sampled.value)
    times, g, rate = times[known], sampled.value[known], sampled.rate[known]
    sign = np.sign(g)
    zeros, others = sign == 0.0, np.flatnonzero(sign != 0.0)
    left, right = others[:-1], others[1:]
    opposite = sign[left] != sign[right]
    # An argument that is zero at several samples in a row begins and ceases to be zero at corners of nested functions,
    # which are found as such.
    isolated = right - left <= 2
    brackets = [(times[left[opposite & isolated]], times[right[opposite & isolated]])]
    adjacent = right - left == 1
    heads_to_zero = adjacent & ~opposite & (sign[left] * rate[left] < 0.0) & (sign[right] * rate[right] > 0.0)
    if heads_to_zero.any():
        a, b = times[left[heads_to_zero]], times[right[heads_to_zero]]
        middle = _bisected(lambda t: argument(t).rate, a, b)
        across = np.sign(argument(middle).value) == -sign[left[heads_to_zero]]
        brackets += [(a[across], middle[across]), (middle[across], b[across])]
    low, high = (np.concatenate(ends) for ends in zip(*brackets, strict=True))
    edges = [k for k in (0, len(times) - 1) if len(times) and zeros[k]]  # a zero at an end of the run
    if not len(low) and not edges:
        return {}
    roots = np.concatenate([_bisected(lambda t: argument(t).value, low, high), times[edges]])
    at = argument(roots)
    ends = np.maximum(np.abs(argument(low).value), np.abs(argument(high).value))
    with np.errstate(all="ignore"):
        noise = 2.0 * at.rounding / np.abs(at.rate)
    values = {}
    for k, root in enumerate(roots):
        if k < len(low) and not abs(at.value[k]) <= ends[k]:
            continue  # a pole, not a change of sign
        values[float(root)] = float(noise[k]) if np.isfinite(noise[k]) else 0.0
    return values


def _bisected(function: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return where `function` changes its sign between `low` and `high` (K,), up to adjacent floating-point numbers."""
    a, b = low.copy(), high.copy()
    if not len(a):
        return a
    sign = np.sign(function(a))
    for _ in range(BISECTIONS):
        middle = 0.5 * (a + b)
        if np.all((middle <= a) | (middle >= b)):
            break
        now = np.sign(function(middle))
        stays = now == sign
        a = np.where(stays | (now == 0.0), middle, a)
        b = np.where(~stays, middle, b)
    return b
