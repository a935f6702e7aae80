"""Force laws as their authors write them: the tension of a force element as a function of length, rate and time.

A law is the scalar force ``F(s, s', t)`` along a pathway of length ``s``: positive pulls the two bodies together. It
comes with ``dF/ds``, ``dF/ds'`` and, where it has one, its potential ``V(s)``, whose slope is the force at rate zero.
Of the power ``F s'`` that the bodies give to the element, ``V_s s'`` is stored; the rest is dissipated where the law is
passive, and otherwise counts as (negative) work of the element.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import sympy

ARGUMENTS = ("length", "rate", "time")
"""Arguments of every law: s [m or rad], its rate s' [m/s or rad/s] and time [s]."""


@dataclass(frozen=True, eq=False)
class ExpressionLaw:
    """A force law written in SymPy; its derivatives are taken by SymPy.

    Parameters
    ----------
    force
        F as an expression in symbols named ``length``, ``rate``, ``time`` and like the law's options, or a function
        without arguments that returns it and is called only to compile or show the law. The expression must consist
        of SymPy functions, and of ``Piecewise``, ``Min``, ``Max`` or ``Abs`` where it has corners or jumps.
    potential
        V, likewise, in ``length`` and options; its derivative by length is checked to be the force at rate zero, on
        which time must have no influence. Left out, the law has none.
    passive
        Whether all power that is not stored is dissipated.
    parameters
        Turns an instance of the law's options into a number for each other symbol, by name; left out, these are the
        options themselves.
    """

    force: sympy.Expr | Callable[[], sympy.Expr]
    potential: sympy.Expr | Callable[[], sympy.Expr] | None = None
    passive: bool = False
    parameters: Callable[[Any], Mapping[str, float]] | None = None


@dataclass(frozen=True, eq=False)
class FunctionLaw:
    """A force law written as a function that Numba can compile.

    Parameters
    ----------
    function
        Takes length, rate, time and an array of parameters; returns four numbers: force, its derivative by length, its
        derivative by rate, and the potential (0.0 where there is none). Of other functions it may call those of its
        own package.
    potential
        Whether the fourth number is a potential: its derivative by length is the force at rate zero, on which time has
        no influence.
    passive
        Whether all power that is not stored is dissipated.
    parameters
        Turns an instance of the law's options into the numbers that the function is given, any number of them; left
        out, these are the options in the order in which they are defined.
    """

    function: Callable[..., tuple[float, float, float, float]]
    potential: bool = False
    passive: bool = False
    parameters: Callable[[Any], Sequence[float]] | None = None


ForceLaw = ExpressionLaw | FunctionLaw
