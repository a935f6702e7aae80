"""Expressions of t against SymPy, and against people who try to get more out of them than arithmetic."""

import math
import operator

import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st

from mbdkit.base.errors import SpecError
from mbdkit.expressions.parser import Expression

BINARY = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}
BINARY |= {"pow": math.pow, "atan2": math.atan2, "min": min, "max": max}


def run(program, t):
    """The smallest interpreter of a program: values only."""
    stack, highest = [], 0
    for operation, number in program:
        if operation == "const":
            stack.append(number)
        elif operation == "t":
            stack.append(t)
        elif operation == "powi":
            stack.append(stack.pop() ** int(number))
        elif operation == "neg":
            stack.append(-stack.pop())
        elif operation in BINARY:
            right, left = stack.pop(), stack.pop()
            stack.append(BINARY[operation](left, right))
        else:
            stack.append({"abs": abs}.get(operation, getattr(math, operation, None))(stack.pop()))
        highest = max(highest, len(stack))
    (value,) = stack
    return value, highest


TEXTS = [
    "3",
    "t",
    "-t",
    "+t",
    "0.5*sin(2*pi*t)",
    "pi/2 + 6*t + 0.2*sin(3*t)",
    "t**3 - 2*t**2 + t - 1",
    "-t**2",
    "2**-t",
    "t**-2",
    "t**2.0",
    "t**0.5",
    "(1 + t)**(t/3)",
    "2**3**t",
    "10 - 4 - 3*t - 2",
    "100/t/5/2",
    "tan(t/4) + asin(t/5) - acos(t/7) + atan(t)",
    "atan2(sin(t), cos(t)) + atan2(t, -1)",
    "exp(-t)*log(1 + t)/sqrt(t)",
    "abs(1 - t) + tanh(3*(t - 1))",
    "min(t, 1) + max(t, 1, 2 - t) + min(3, t, t**2, 1 - t)",
    "1e-3*t + 1000 + .5 + 0x10",
    " t +\n 1 ",
    "+".join(f"sin({k}*t)/{k}" for k in range(1, 400)),
]


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("t", [0.3, 1.7])
def test_program_gives_the_value_that_sympy_gives_for_the_text(text, t):
    expected = sympy.sympify(
        " ".join(text.split()), {"t": sympy.Float(t, 30), "abs": sympy.Abs, "min": sympy.Min, "max": sympy.Max}
    )
    expression = Expression.parse(text)
    value, highest = run(expression.program, t)
    assert value == pytest.approx(float(expected), rel=1e-13)
    assert highest == expression.depth


@pytest.mark.parametrize("text", TEXTS)
def test_sympy_form_gives_the_value_of_the_program(text):
    expression = Expression.parse(text)
    value, _ = run(expression.program, 0.7)
    assert float(expression.to_sympy().subs(sympy.Symbol("t", real=True), 0.7)) == pytest.approx(value, rel=1e-12)


def test_constant_parts_are_computed_once():
    assert Expression.parse("2*pi*sqrt(4)/-2").program == (("const", -2 * math.pi),)
    assert Expression.parse("2*pi*t").program == (("const", 2 * math.pi), ("t", 0.0), ("mul", 0.0))


@pytest.mark.parametrize(
    ("text", "exponent"), [("t**3", 3), ("t**-2", -2), ("t**2.0", 2), ("t**(1+1)", 2), ("t**0", 0)]
)
def test_whole_exponents_are_integer_powers(text, exponent):
    assert Expression.parse(text).program == (("t", 0.0), ("powi", exponent))


def test_other_exponents_are_general_powers():
    assert Expression.parse("t**0.5").program == (("t", 0.0), ("const", 0.5), ("pow", 0.0))
    assert Expression.parse("2**t").program == (("const", 2.0), ("t", 0.0), ("pow", 0.0))


@given(
    st.recursive(
        st.sampled_from(["t", "pi", "2", "0.5"]),
        lambda inner: st.one_of(
            st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda x: f"({x[0]} {x[1]} {x[2]})"),
            st.tuples(st.sampled_from(["sin", "cos", "atan", "tanh", "abs"]), inner).map(lambda x: f"{x[0]}({x[1]})"),
            inner.map(lambda x: f"-{x}"),
        ),
        max_leaves=12,
    ),
    st.floats(-3, 3),
)
def test_any_sum_of_products_agrees_with_sympy(text, t):
    expected = float(sympy.sympify(text, {"t": sympy.Float(t, 40), "abs": sympy.Abs}).evalf(30))
    assert run(Expression.parse(text).program, t)[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


REACHING = ["__import__('os')", "__import__('os').system('true')", "().__class__.__bases__[0]", "sin.__globals__"]
CALLS = ["(lambda: t)()", "print(t)", "eval(t)", "open(t)", "sin(*t)", "sin(x=t)", "min(t, key=t)", "sin", "sin()"]
CALLS += ["sin(t, t)", "atan2(t)", "atan2(t, t, t)", "min(t)", "Sin(t)", "\uff53\uff49\uff4e(t)"]
LOGIC = ["lambda: t", "t if t else 1", "t < 1", "t and 1", "not t", "~t", "t | 1", "t << 2", "(x := 3)", "await t"]
VALUES = [
    "[t][0]",
    "{t: t}",
    "(t, t)",
    "[x for x in (1, 2)]",
    "'a'",
    "f'{t}'",
    "b'a'",
    "1j",
    "True",
    "...",
    "x",
    "π*t",
    "None",
]
SIGNS = ["t.real", "t % 2", "t // 2", "t @ t", "t ^ 2", "2t", "t t", "", "   ", "()", "t +", "(t", "t\x00"]
STATEMENTS = ["t; t", "t = 1", "import os", "t # comment", "t \\\n + 1"]


@pytest.mark.parametrize("text", [*REACHING, *CALLS, *LOGIC, *VALUES, *SIGNS, *STATEMENTS])
def test_anything_but_arithmetic_is_refused(text):
    with pytest.raises(SpecError):
        Expression.parse(text)


@pytest.mark.parametrize(
    "text",
    ["9**9**9", "9**9**9*t", "1e999", "1/0", "t + log(-1)", "sqrt(-1)", "(-8)**(1/3)", "0**-1", "9" * 400, "asin(2)"],
)
def test_constants_that_are_no_finite_number_are_refused(text):
    with pytest.raises(SpecError, match="not a finite number"):
        Expression.parse(text)


@pytest.mark.parametrize(
    "text",
    [
        *(before * n + "t" + ")" * n for before, n in (("(", 5000), ("sin(", 2000), ("t+(", 2000), ("t+(", 40))),
        "(" * 150 + "t" + ")" * 150 + "*t" * 3000,
        *("-" * 9000 + "t", "t**" * 3000 + "t", "1" * 9000, "t" * 9000, "t+" * 20000 + "t", "t**1000001"),
    ],
)
def test_huge_or_deep_expressions_are_refused_and_harm_nothing(text):
    with pytest.raises(SpecError):
        Expression.parse(text)


def test_a_mistyped_name_is_answered_with_the_right_one_and_its_position():
    with pytest.raises(SpecError, match=r"'sine' is not a function .* \(did you mean 'sin'\?\) \(position 5 of"):
        Expression.parse("2 + sine(t)")


def test_the_position_counts_from_the_start_of_what_was_written():
    with pytest.raises(SpecError, match=r"unknown name 'x'; known: t, pi and functions \(position 7 of"):
        Expression.parse("  t + x")


def test_underscores_of_python_in_numbers_are_refused():
    with pytest.raises(SpecError, match=r"no underscores: write 10\.5 \(position 7 of '2\*t \+ 1_0\.5'\)"):
        Expression.parse("2*t + 1_0.5")


def test_a_caret_is_answered_with_the_power_operator():
    with pytest.raises(SpecError, match=r"a power is written \*\*"):
        Expression.parse("t^2")
