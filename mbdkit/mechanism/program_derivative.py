"""The derivative of a program of a smooth expression, as a program.

Forward-mode differentiation (`mbdkit.engine.kernels.motions`) gives two derivatives of a program. Applied to the
program of the derivative as well, it gives three.
"""

from __future__ import annotations

from mbdkit.mechanism.time_expression import Program

KINKED = ("abs", "min", "max", "atan2")
"""Operations whose derivatives jump, which have no program here."""


def derivative_of(program: Program) -> Program:
    """Return the program of the derivative of a program without `KINKED` operations."""
    stack: list[tuple[Program, Program]] = []
    for operation, number in program:
        if operation in ("const", "t"):
            stack.append((((operation, number),), _constant(1.0 if operation == "t" else 0.0)))
        elif operation in ("add", "sub", "mul", "div", "pow"):
            b, a = stack.pop(), stack.pop()
            stack.append(((*a[0], *b[0], (operation, 0.0)), _binary(operation, *a, *b)))
        else:
            f, df = stack.pop()
            value = (*f, (operation, number))
            stack.append((value, _product(_slope(operation, number, f, value), df)))
    return stack.pop()[1]


def _constant(value: float) -> Program:
    return (("const", value),)


_ZERO, _ONE = _constant(0.0), _constant(1.0)


def _sum(a: Program, b: Program, operation: str = "add") -> Program:
    if b == _ZERO:
        return a
    if a == _ZERO:
        return b if operation == "add" else (*b, ("neg", 0.0))
    return (*a, *b, (operation, 0.0))


def _product(a: Program, b: Program) -> Program:
    if _ZERO in (a, b):
        return _ZERO
    if a == _ONE:
        return b
    return a if b == _ONE else (*a, *b, ("mul", 0.0))


def _quotient(a: Program, b: Program) -> Program:
    return a if a == _ZERO or b == _ONE else (*a, *b, ("div", 0.0))


def _binary(operation: str, f: Program, df: Program, g: Program, dg: Program) -> Program:
    """Return the derivative of a binary operation on `f` and `g`."""
    if operation in ("add", "sub"):
        return _sum(df, dg, operation)
    if operation == "mul":
        return _sum(_product(df, g), _product(f, dg))
    if operation == "div":  # f' / g - (f / g) (g' / g)
        return _sum(_quotient(df, g), _product(_quotient(f, g), _quotient(dg, g)), "sub")
    value = (*f, *g, ("pow", 0.0))
    if dg == _ZERO:  # g f^(g - 1) f'
        return _product(_product(g, (*f, *g, *_ONE, ("sub", 0.0), ("pow", 0.0))), df)
    inner = _sum(_product(dg, (*f, ("log", 0.0))), _product(g, _quotient(df, f)))
    return _product(value, inner)


def _slope(operation: str, number: float, f: Program, value: Program) -> Program:
    """Return the derivative of a function of one argument `f` by this argument; `value` is the function."""
    square: tuple[str, float] = ("powi", 2.0)
    match operation:
        case "neg":
            return _constant(-1.0)
        case "powi":
            return _product(_constant(number), _ONE if number == 1.0 else (*f, ("powi", number - 1.0)))
        case "sin":
            return (*f, ("cos", 0.0))
        case "cos":
            return (*f, ("sin", 0.0), ("neg", 0.0))
        case "tan":
            return (*value, square, *_ONE, ("add", 0.0))
        case "tanh":
            return (*_ONE, *value, square, ("sub", 0.0))
        case "atan":
            return _quotient(_ONE, (*f, square, *_ONE, ("add", 0.0)))
        case "asin" | "acos":
            root = (*_ONE, *f, square, ("sub", 0.0), ("sqrt", 0.0))
            return _quotient(_constant(1.0 if operation == "asin" else -1.0), root)
        case "exp":
            return value
        case "log":
            return _quotient(_ONE, f)
        case "sqrt":
            return _quotient(_constant(0.5), value)
    raise ValueError(f"no derivative of {operation!r}")
