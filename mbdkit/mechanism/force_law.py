"""Definitions of force laws: the tension of a force element as a function of length, rate and time.

A law defines the scalar force ``F(s, s', t)`` along a pathway of length ``s``; a positive force pulls the two bodies
together. It also defines ``dF/ds``, ``dF/ds'`` and, optionally, a potential ``V(s)`` with ``dV/ds = F(s, 0)``. The
bodies supply the power ``F s'`` to the element, which stores the part ``dV/ds s'``. If the law is passive, the element
dissipates the remainder; otherwise the remainder counts as negative work of the element.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from math import inf
from typing import TYPE_CHECKING, Any, ClassVar

from mbdkit.base.errors import PluginError, blaming
from mbdkit.base.frozen import dataclass, field
from mbdkit.base.text import listed
from mbdkit.base.traced_numbers import as_float

if TYPE_CHECKING:
    import sympy

#: Arguments of every law: length s [m or rad], rate s' [m/s or rad/s] and time t [s].
ARGUMENTS = ("length", "rate", "time")

#: Lowest and highest value for some arguments of a law, by name; other arguments may have any value.
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class ExpressionLaw:
    """A force law as a SymPy expression, which SymPy differentiates.

    Parameters
    ----------
    force
        F as an expression in the symbols ``length``, ``rate``, ``time`` and one symbol for each parameter, or a
        function without arguments that returns this expression and is called only to compile or display the law. The
        expression may contain SymPy functions; use ``Piecewise``, ``Min``, ``Max`` or ``Abs`` for discontinuities.
    potential
        V as an expression, or a function that returns it, in ``length`` and the parameters; None if the law has no
        potential. Its derivative with respect to length must equal the force at rate zero, which must not depend on
        time; this is checked.
    passive
        Whether all power that is not stored in the potential is dissipated.
    parameters
        Function from an instance of the law's options to the values of the parameters by name; by default, the
        parameters are the numeric options themselves.
    rates
        First-order states of an element with this law: for each name, the time derivative (an expression like `force`,
        or a function that returns it) and the unit of the state. A parameter of the same name gives the initial value.
        All expressions may contain the state by its name. A law with states has no potential, so its
        power counts as work, or as dissipated if the law is passive.
    valid_range
        Range in which the law holds, such as ``{"length": (0.0, 0.3), "rate": (-1.0, 1.0)}`` [SI units, radians], or a
        function from an instance of the law's options to such a range; bounds may be infinite. The law must give finite
        numbers outside the range, too. A run that leaves the range is judged doubtful, or stops if ``limits.law_range``
        is ``stop``.
    """

    force: sympy.Expr | Callable[[], sympy.Expr]
    potential: sympy.Expr | Callable[[], sympy.Expr] | None = None
    passive: bool = False
    parameters: Callable[[Any], Mapping[str, float]] | None = None
    rates: Mapping[str, tuple[sympy.Expr | Callable[[], sympy.Expr], str]] = field(default_factory=dict)
    valid_range: Ranges | Callable[[Any], Ranges] = field(default_factory=dict)

    @cached_property
    def states(self) -> tuple[LawState, ...]:
        """The first-order states of an element with this law."""
        return tuple(
            LawState(name, ExpressionLaw(rate, parameters=self.parameters), unit)
            for name, (rate, unit) in self.rates.items()
        )


@dataclass(frozen=True, eq=False)
class LawState:
    """A first-order state z of an element, z' = g(s, s', t, z).

    `name`: name of the state. The law has a parameter of this name: its value is the initial value of the state, and
    its symbol in the law stands for the state. `rate`: time derivative of the state, in the form of a law with the same
    parameters. `unit`: unit of the state.
    """

    name: str
    rate: ExpressionLaw | TracedLaw
    unit: str


@dataclass(frozen=True, eq=False)
class FunctionLaw:
    """A force law as a function that Numba can compile.

    Parameters
    ----------
    function
        Function of length, rate, time and an array of parameters, which returns four numbers: the force, its
        derivatives with respect to length and to rate, and the potential (0.0 if there is none). It may call other
        functions only from its own package.
    potential
        Whether the fourth number is a potential. The derivative of a potential with respect to length equals the force
        at rate zero, which must not depend on time.
    passive
        Whether all power that is not stored is dissipated.
    parameters
        Function from an instance of the law's options to the array of parameters, of any length; by default, the
        parameters are the options in the order of their definition.
    valid_range
        Range in which the law holds; see `ExpressionLaw`.
    """

    function: Callable[..., tuple[float, float, float, float]]
    potential: bool = False
    passive: bool = False
    parameters: Callable[[Any], Sequence[float]] | None = None
    valid_range: Ranges | Callable[[Any], Ranges] = field(default_factory=dict)
    states: ClassVar[tuple[LawState, ...]] = ()


@dataclass(frozen=True, eq=False)
class TracedLaw:
    """A force law, or the rate of a state, as a Python function without branches that is traced to a program.

    Unlike an `ExpressionLaw`, such a function computes intermediate results only once, so that a law may contain a
    fixed number of iterations.

    Parameters
    ----------
    function
        Function of length, rate, time and a mapping with the parameters by name, which returns the force, or the
        rate of a state. It may use numbers, operators, functions of NumPy and ``numpy.where``.
    parameters
        Function from an instance of the law's options to the values of the parameters by name.
    states
        First-order states of an element with this law, whose rates have the same parameters.
    has_derivatives
        Whether derivatives with respect to length and rate are needed; they are not for the rate of a state.
    passive
        Whether all power is dissipated.
    valid_range
        Range in which the law holds; see `ExpressionLaw`.
    """

    function: Callable[[Any, Any, Any, Mapping[str, Any]], Any]
    parameters: Callable[[Any], Mapping[str, float]]
    states: tuple[LawState, ...] = ()
    has_derivatives: bool = True
    passive: bool = False
    valid_range: Ranges | Callable[[Any], Ranges] = field(default_factory=dict)
    potential: ClassVar[None] = None


@dataclass(frozen=True, eq=False)
class RecordedExpression(ExpressionLaw):
    """An expression law whose program is recorded, without SymPy; its form in SymPy, `force`, follows when it is asked.

    Parameters
    ----------
    function
        See `TracedLaw`.
    """

    function: Any = None
    has_derivatives: ClassVar[bool] = False


@dataclass(frozen=True, eq=False)
class SwitchingLaw(ExpressionLaw):
    """An expression law of which it is known, without SymPy, where it is not smooth.

    Parameters
    ----------
    switch
        Function of length, rate and a mapping with the parameters by name, whose sign changes there. It is recorded,
        as that of a `TracedLaw`. None for a law that is smooth in the steps that use it.
    """

    switch: Any = None


ForceLaw = ExpressionLaw | FunctionLaw | TracedLaw


def law_parameters(law: ForceLaw, options: object, name: str) -> tuple[tuple[str, ...], list[float]]:
    """Return the names and values of a law's parameters; those of functions and of machine code have no names.

    `name`: name of the law for error messages. Raises PluginError if the law fails to compute its parameters, or if
    they are not usable. Raises SpecError if the law itself raises it for these options.
    """
    with blaming(f"force law {name} failed to compute its parameters"):
        names, values = _parameters(law, options)
    if clash := sorted(set(names) & set(ARGUMENTS)):
        raise PluginError(
            f"force law {name}: its parameter '{clash[0]}' has the name of an argument of the law; rename it"
        )
    if missing := [state.name for state in law.states if state.name not in names]:
        raise PluginError(
            f"force law {name}: its state '{missing[0]}' needs a parameter of this name for its initial value"
        )
    if law.states and law.potential not in (None, False):
        raise PluginError(f"force law {name} has states, so its force cannot have a potential; leave out `potential`")
    if not all(abs(value) < inf for value in values):
        raise PluginError(f"force law {name} computed parameters that are not finite")
    return names, values


def law_range(law: ForceLaw, options: object, name: str) -> dict[str, tuple[float, float]]:
    """Return the lowest and the highest value of each argument (length, rate, time) for which a law holds.

    The values are infinite for arguments without a bound.

    `name`: name of the law for error messages. Raises PluginError if the law fails to compute its range, or if the
    result is not a range. Raises SpecError if the law itself raises it for these options.
    """
    with blaming(f"force law {name} failed to compute its valid range"):
        given: Any = law.valid_range(options) if callable(law.valid_range) else law.valid_range
    ranges = dict.fromkeys(ARGUMENTS, (-inf, inf))
    if not isinstance(given, Mapping) or not set(given) <= set(ARGUMENTS):
        raise PluginError(
            f"force law {name}: its valid range should be a mapping whose keys are {listed(ARGUMENTS, 'or')}"
        )
    for argument, bounds in given.items():
        try:
            low, high = map(float, bounds)
        except (TypeError, ValueError):
            low, high = inf, -inf
        if not low < high:
            raise PluginError(
                f"force law {name}: its valid range of {argument} should be two numbers, the lower one first"
            )
        ranges[argument] = low, high
    return ranges


def _parameters(law: ForceLaw, options: object) -> tuple[tuple[str, ...], list[float]]:
    given: Any
    if law.parameters is not None:
        given = law.parameters(options)
    elif isinstance(law, ExpressionLaw):
        every = {option: getattr(options, option) for option in law_options(options)}
        given = {option: value for option, value in every.items() if isinstance(value, int | float)}
    else:
        given = [getattr(options, option) for option in law_options(options)]
    if not isinstance(law, ExpressionLaw | TracedLaw):
        return (), [*map(as_float, given)]
    names = tuple(sorted(given))
    return names, [as_float(given[name]) for name in names]


def law_options(options: Any) -> list[str]:
    """Return the names of those options of an element that belong to its law, in the order of their definition."""
    return list(type(options).law_options.model_fields)
