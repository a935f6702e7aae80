"""Recorded functions: their derivatives are those of high-precision differences, also in programs for kernels."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import Any

import mpmath
import numpy as np
import pytest

from mbdkit.base import elementary
from mbdkit.base.errors import PluginError
from mbdkit.engine.function_program import block
from mbdkit.engine.kernels import motions
from mbdkit.expressions.parser import Expression
from mbdkit.expressions.program import value_of
from mbdkit.expressions.recorded import Recorded, Recorder
from mbdkit.expressions.recorded_derivatives import derivative, derivatives
from mbdkit.mechanism.variable_functions import Profile

from .graphs import FLOATS, NAMES, PRECISE, drawn, run_block, run_block_with_duals, values


def inputs_of(of: Recorded) -> list[Recorded]:
    terms = of.recorder.terms
    return [Recorded(of.recorder, i) for i in of.recorder.ancestors([of]) if terms[i].operation == "input"]


def differences(function: Callable[..., Any], at: list[float], order: int) -> list[Any]:
    """Return value and derivatives of a function, in the order of `derivatives`, by differences with 60 digits."""
    found = []
    with mpmath.workdps(60):
        point = [mpmath.mpf(x) for x in at]
        for size in range(order + 1):
            for chosen in combinations_with_replacement(range(len(at)), size):
                orders = tuple(chosen.count(i) for i in range(len(at)))
                found.append(mpmath.diff(function, tuple(point), orders) if size else function(*point))
    return found


@pytest.mark.parametrize("seed", range(8))
def test_derivatives_of_drawn_functions_to_third_order(seed: int) -> None:
    numbers = random.Random(seed)
    for _ in range(25):
        recorder = Recorder()
        function = drawn(recorder, numbers)
        by = inputs_of(function)
        names = [one.term.data for one in by]
        at = [numbers.uniform(0.3, 1.4) for _ in by]
        found = derivatives(function, by, 3)
        wanted = differences(lambda *x: values([function], dict(zip(names, x)), PRECISE)[0], at, 3)  # noqa: B023, B905
        arithmetic = values(found, dict(zip(names, at, strict=True)), FLOATS)
        program = block([*map(recorder.input, NAMES)], found)
        given = dict.fromkeys(NAMES, 0.5) | dict(zip(names, at, strict=True))
        *parameters, time = given.values()
        assert run_block(program, parameters, time).tolist() == arithmetic  # the same bits
        size = max(1.0, *(abs(float(x)) for x in wanted))
        np.testing.assert_allclose(arithmetic, np.array(wanted, dtype=float), rtol=0, atol=1e-12 * size)


def test_a_root_has_the_derivatives_of_the_implicit_function() -> None:
    recorder = Recorder()
    x, y, t = (recorder.input(name) for name in ("x", "y", "t"))

    def condition(s: Any, x: Any, y: Any, sin: Any) -> Any:
        return s * s * s + x * s - y + 0.1 * sin(s * y)

    s = Profile.of(lambda s: condition(s, x, y, np.sin)).root(x)
    found = derivatives(np.cos(s) * x, [x, y], 3)
    at = [0.8, 1.3]

    def implicit(x: Any, y: Any) -> Any:
        return mpmath.cos(mpmath.findroot(lambda s: condition(s, x, y, mpmath.sin), 0.8)) * x

    wanted = differences(implicit, at, 3)
    np.testing.assert_allclose(run_block(block([x, y, t], found), at), np.array(wanted, dtype=float), rtol=3e-13)


def test_a_root_within_the_condition_of_a_root() -> None:
    recorder = Recorder()
    x, y, t = (recorder.input(name) for name in ("x", "y", "t"))
    outer = Profile.of(lambda r: r - 0.1 * Profile.of(lambda s: s * s - x * r * r - y).root(x + y)).root(x)
    found = derivatives(outer, [x, y], 2)
    at = [1.2, 0.7]

    def implicit(x: Any, y: Any) -> Any:
        return mpmath.findroot(lambda r: r - mpmath.sqrt(x * r * r + y) / 10, 0.1)

    wanted = differences(implicit, at, 2)
    np.testing.assert_allclose(run_block(block([x, y, t], found), at), np.array(wanted, dtype=float), rtol=1e-13)


@pytest.mark.parametrize("y", [-1.0, 0.0], ids=["no root", "double root"])
def test_a_root_that_is_not_found_is_nan(y: float) -> None:
    recorder = Recorder()
    x, t = recorder.input("y"), recorder.input("t")
    s = Profile.of(lambda s: s * s - x).root(recorder.constant(0.7))
    assert np.isnan(run_block(block([x, t], [s, derivative(s, x)]), [y])).all()


def test_dual_numbers_differentiate_programs() -> None:
    recorder = Recorder()
    x, y, t = (recorder.input(name) for name in ("x", "y", "t"))
    functions = [
        np.arctan2(y, -x),
        np.hypot(x, y * y),
        recorder.table([0.0, 0.5, 2.0], [[0.3, 1.0, -2.0], [0.1, 0.4, 0.7]], x + y, 1.7),
        Profile.of(lambda s: np.exp(s) * x - y).root(recorder.constant(0.5)),
    ]
    recorded = [one for function in functions for one in derivatives(function, [x, y], 1)]
    wanted = run_block(block([x, y, t], recorded), [0.4, 0.9]).reshape(-1, 3)
    found = run_block_with_duals(block([x, y, t], functions), [0.4, 0.9])
    np.testing.assert_allclose(found, wanted, rtol=1e-14)


@pytest.mark.parametrize("period", [0.0, 2.5])
def test_tables_have_the_values_of_motions_and_derivatives_of_all_orders(period: float) -> None:
    knots, coefficients = [0.5, 1.0, 3.0], np.array([[1.0, 0.2, 3.1, -0.4], [0.7, -1.0, 0.3, 0.6]])
    recorder = Recorder()
    x, t = recorder.input("x"), recorder.input("t")
    program = block([x, t], derivatives(recorder.table(knots, coefficients, x, period), [x], 4))
    numbers = np.array([2.0, 4.0, period, *knots, *coefficients.ravel()])
    for at in np.linspace(-1.0, 4.0, 23):
        value = run_block(program, [at])
        assert value[:3].tolist() == [*motions._piecewise_polynomial(at, numbers, 0)]
        inside = 0.5 + (at - 0.5) % period if period else at
        assert value[3:].tolist() == [6 * coefficients[int(inside >= 1.0), 3], 0.0]
    squares = run_block(block([x, t], derivatives(recorder.table(knots, coefficients, x * x), [x], 2)), [0.9])
    u = 0.81 - 0.5
    outer = [np.polynomial.Polynomial(coefficients[0]).deriv(k)(u) for k in (0, 1, 2)]
    np.testing.assert_allclose(squares, [outer[0], 1.8 * outer[1], 3.24 * outer[2] + 2 * outer[1]], rtol=1e-14)


def test_a_table_with_a_wrong_number_of_knots_is_refused() -> None:
    recorder = Recorder()
    with pytest.raises(PluginError, match="a table of 2 pieces needs 3 knots"):
        recorder.table([0, 1], [[1.0], [2.0]], recorder.input("x"))


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda x: abs(x), "'abs' has no derivative where its operand is 0, so it cannot be part of .* a constraint"),
        (lambda x: np.minimum(x * x, 1.0), "'minimum' has no derivative where its operands are equal"),
        (lambda x: np.maximum(x, 0.0), "'maximum' has no derivative"),
        (lambda x: np.floor(x) * x, "'floor' jumps at integers"),
        (lambda x: x % 2.0, "'remainder' jumps at multiples of its divisor"),
    ],
)
def test_operations_without_derivative_are_refused(function: Callable[[Any], Any], words: str) -> None:
    recorder = Recorder()
    x, y = recorder.input("x"), recorder.input("y")
    assert derivative(function(y) + x, x).number == 1.0  # a function of other inputs is no obstacle
    with pytest.raises(PluginError, match=words):
        derivative(function(x), x)


def test_what_cannot_be_recorded_is_refused() -> None:
    recorder = Recorder()
    x, y = recorder.input("x"), Recorder().input("y")
    with pytest.raises(PluginError, match=r"cannot branch on its arguments: use numpy\.where"):
        max(x, 1.0)
    with pytest.raises(PluginError, match="'heaviside' is not one of the functions that can be recorded"):
        np.heaviside(x, 1.0)
    with pytest.raises(PluginError, match="two recordings"):
        x + y
    with pytest.raises(PluginError, match="with respect to an input"):
        derivative(x, 2.0 * x)
    with pytest.raises(PluginError, match="depends on 'x', which is not one of its inputs"):
        block([recorder.input("t")], [x])
    terms = [np.sin(k * x) for k in range(600)]
    with pytest.raises(PluginError, match=r"need \d+ registers, more than 512"):
        block([x], [sum(terms[k] * terms[-1 - k] for k in range(600))])


def test_equal_terms_occur_once_and_programs_are_small() -> None:
    recorder = Recorder()
    x, y, beta, t = (recorder.input(name) for name in ("x", "y", "beta", "t"))
    psi = np.arctan2(y, x)
    assert (2.0 * psi).index == (np.arctan2(y, x) * 2.0).index
    gear = derivatives(-0.03 * psi + 0.05 * (beta - psi), [x, y, beta], 2)
    assert block([x, y, beta, t], gear)[0] < 45


def test_deep_functions_need_no_recursion() -> None:
    recorder = Recorder()
    s = x = recorder.input("x")
    for _ in range(1500):
        s = np.sin(s) + x
    program = block([x, recorder.input("t")], derivatives(s, [x], 2))
    assert np.isfinite(run_block(program, [0.3])).all()


def test_texts_and_sympy_expressions_are_recorded() -> None:
    import sympy

    recorder = Recorder()
    x, t = recorder.input("x"), recorder.input("t")
    program = Expression.parse("2*sin(3*t)**2 - atan2(t, 1 + t**2)/sqrt(2)").program
    text = value_of(program, lambda name, number: recorder.constant(number) if name == "const" else t)
    a, b = sympy.symbols("a b")
    formula = 2 * sympy.sin(3 * b) ** 2 - sympy.atan2(b, 1 + b**2) / sympy.sqrt(2) + a * b**3
    written = sympy.lambdify([a, b], formula, modules="numpy")(x, t)
    results = run_block(block([x, t], [*derivatives(text, [t], 2), *derivatives(written, [x, t], 1)]), [0.4], 0.7)
    expected = [formula.subs(a, 0).diff(b, k) for k in range(3)] + [formula, formula.diff(a), formula.diff(b)]
    np.testing.assert_allclose(results, [float(one.subs({a: 0.4, b: 0.7})) for one in expected], rtol=1e-14)


def test_constants_are_folded_with_the_bits_of_the_machine_code() -> None:
    recorder = Recorder()
    assert np.sin(recorder.constant(0.3)).number == elementary.sin(0.3)
    assert np.isnan(np.sqrt(recorder.constant(-1.0)).number)
    assert (recorder.constant(1.0) / recorder.constant(-0.0)).number == -np.inf
