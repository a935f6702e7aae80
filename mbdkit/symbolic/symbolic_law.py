"""Force laws written in SymPy: checks, derivatives and generated Python source."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from mbdkit.base.errors import PluginError
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw

LENGTH, RATE, T = (sp.Symbol(name, real=True) for name in ARGUMENTS)

#: Prefix of parameters that select one side of each discontinuity of a law (`mbdkit_gradients.law_corners`).
#:
#: The potential of a law with such parameters is not checked, because it belongs to the force on the selected side
#: only.
SIDE = "mbdkit_side_"

_CORNERED = (sp.Abs, sp.Min, sp.Max, sp.Heaviside, sp.sign)


def law_expressions(law: ExpressionLaw, names: Sequence[str]) -> tuple[sp.Expr, sp.Expr]:
    """Return force and potential of a law in real symbols named like its arguments and parameters.

    Raises
    ------
    PluginError
        If the law is not a SymPy expression in these arguments and parameters.
    """
    potential = 0 if law.potential is None else law.potential
    return _expression(law.force, names, ARGUMENTS), _expression(potential, names, ARGUMENTS[:1])


def law_force(
    law: ExpressionLaw, parameters: Mapping[str, sp.Expr], length: sp.Expr, rate: sp.Expr, time: sp.Expr
) -> sp.Expr:
    """Return the force of a law as an expression of these values of its parameters and arguments."""
    force, _ = law_expressions(law, [*parameters])
    known = {sp.Symbol(name, real=True): value for name, value in parameters.items()}
    return force.xreplace({**known, LENGTH: length, RATE: rate, T: time})


def _expression(given: object, names: Sequence[str], arguments: Sequence[str]) -> sp.Expr:
    made = given() if callable(given) else given
    try:
        expression = sp.sympify(made, strict=True)
    except sp.SympifyError:
        expression = None
    if not isinstance(expression, sp.Expr):
        raise PluginError(f"an object of type {type(made).__name__} is not a SymPy expression")
    known = [*arguments, *names]
    for symbol in sorted(expression.free_symbols, key=str):
        if str(symbol) not in known:
            what = "potential" if len(arguments) == 1 else "force"
            raise PluginError(
                f"the symbol '{symbol}' of its {what} is not one of {listed(known)}{did_you_mean(str(symbol), known)}"
            )
    return expression.xreplace({symbol: sp.Symbol(str(symbol), real=True) for symbol in expression.free_symbols})


def law_results(law: ExpressionLaw, example: Mapping[str, float]) -> list[sp.Expr]:
    """Return the force of a law, its derivatives with respect to length and rate, and the potential.

    Parameters
    ----------
    example
        Names of the law's parameters with example values at which the potential is checked.

    Raises
    ------
    PluginError
        If SymPy cannot differentiate the force, or the derivative of the potential is not the force at rate zero.
    """
    names = list(example)
    force, potential = smooth_pieces(law, names)
    results = [force, force.diff(LENGTH), force.diff(RATE), potential]
    for result in results:
        if result.has(sp.Derivative, sp.Subs, sp.DiracDelta, sp.core.function.AppliedUndef):
            raise PluginError(f"SymPy cannot differentiate its force {force}")
    if law.potential is not None and not any(name.startswith(SIDE) for name in names):
        _check_potential(force, potential, example)
    return results


def law_source(law: ExpressionLaw, example: Mapping[str, float]) -> str:
    """Return the source of ``law(length, rate, time, parameters)``, which returns `law_results`."""
    names, results = list(example), law_results(law, example)
    local = {sp.Symbol(name, real=True): sp.Symbol(f"p_{i}", real=True) for i, name in enumerate(names)}
    used = set().union(*(result.free_symbols for result in results))
    temporaries, reduced = sp.cse(
        [result.xreplace(local) for result in results], symbols=sp.numbered_symbols("x_", real=True)
    )
    printer = PythonCodePrinter({"fully_qualified_modules": False, "strict": False})
    lines = ["def law(length, rate, time, parameters):"]
    lines += [f"    {p} = parameters[{i}]  # {name}" for i, (name, p) in enumerate(local.items()) if name in used]
    lines += [f"    {symbol} = {printer.doprint(expression)}" for symbol, expression in temporaries]
    lines.append(f"    return {', '.join(f'float({printer.doprint(term)})' for term in reduced)}")
    return "\n".join(lines) + "\n"


def smooth_pieces(law: ExpressionLaw, names: Sequence[str]) -> tuple[sp.Expr, sp.Expr]:
    """Return force and potential of a law, with all discontinuities written as conditions of ``Piecewise``; see
    `law_expressions`.
    """
    force, potential = (_without_corners(expression) for expression in law_expressions(law, names))
    return force, potential


def _without_corners(expression: sp.Expr) -> sp.Expr:
    # Second derivatives of Abs, Min and Max, and first derivatives of sign and Heaviside, contain DiracDelta, which
    # `law_source` rejects; those of Piecewise do not.
    return expression.rewrite(sp.Piecewise) if expression.has(*_CORNERED) else expression


def _check_potential(force: sp.Expr, potential: sp.Expr, example: Mapping[str, float]) -> None:
    """Raise PluginError unless the derivative of the potential with respect to length equals the force at rate zero.

    The two expressions are compared at 40 random lengths for each of several scales, which are 1 and the absolute value
    of each parameter. The random numbers are the same in every call.
    """
    at_rest = force.subs(RATE, 0)
    if at_rest.has(T):
        raise PluginError("a law whose force at rate zero depends on time has no potential: remove the potential")
    slope = potential.diff(LENGTH)
    values = {sp.Symbol(name, real=True): value for name, value in example.items()}
    both = sp.lambdify([LENGTH, *values], [slope, at_rest], modules="math")
    numbers = random.Random(0)
    for scale in (1.0, *(abs(value) for value in example.values())) * 40:
        try:
            computed, wanted = both(scale * numbers.uniform(-2.0, 2.0), *values.values())
        except (ArithmeticError, ValueError, TypeError):  # outside the domain of the expressions
            continue
        if isinstance(computed, complex) or isinstance(wanted, complex):
            continue  # a power of a negative number
        if not (math.isfinite(computed) and math.isfinite(wanted)):
            continue
        if abs(computed - wanted) > 1e-8 * max(abs(computed), abs(wanted)):
            raise PluginError(f"the derivative of its potential, {slope}, is not its force at rate zero, {at_rest}")
