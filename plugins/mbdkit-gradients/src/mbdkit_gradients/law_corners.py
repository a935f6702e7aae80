"""Discontinuities of force laws and their derivatives (*corners*), and mechanisms whose laws use one side of each
corner.

A law that is a SymPy expression, or the derivative of such a law, may be discontinuous where a condition of a
``Piecewise`` changes, such as at the beginning of contact; so is the derivative of friction in a joint at the
transition speed. Each condition compares a function g of length, rate and parameters with zero. In a mechanism with
sides, additional parameters of the law, the *sides*, replace the conditions: a side is 1 where g > 0, and otherwise -1.
The sides are constant during a step, so that the law is smooth in the states of all stages; steps end where g is zero.
Laws of kinds of elements may have such sides, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.force_laws import bind_law
from mbdkit.engine.friction_forces import PIN, SLIDE
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.kernels.table_rows import LAW_ROW, STATE_ROW
from mbdkit.engine.law_conditions import LawCondition, gradient_doubts, law_sides
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.mechanism.force_law import ARGUMENTS, ExpressionLaw, FunctionLaw, SwitchingLaw, TracedLaw
from mbdkit_gradients.gradient_parameters import refused

if TYPE_CHECKING:
    import sympy

#: Name of the parameter with the side of a condition; see `mbdkit.symbolic.symbolic_law.SIDE`.
SIDE = "mbdkit_side_{}"


@dataclass(frozen=True)
class SidedLaw:
    """A law in which sides, which are parameters, replace the conditions.

    Attributes
    ----------
    law
        The law with sides.
    conditions
        Functions that return g and its derivatives with respect to all of their arguments. These are length, rate and
        the parameters of the original law, in the order of the law.
    """

    law: ExpressionLaw | TracedLaw
    conditions: tuple[Callable[..., list[float]], ...]


@dataclass(frozen=True)
class ForceCondition:
    """A condition of the law of a force element.

    Attributes
    ----------
    force
        Name of the force element.
    element
        Index of this element among the force elements.
    parameters
        (n,) indices of the parameters of the original law in ``Topology.law_parameters`` of the mechanism with sides.
    side
        Index of the parameter with the side in ``Topology.law_parameters``.
    function
        See `SidedLaw`.
    multipliers
        (N, 3) parameters that are multipliers of joints: pair and row of the multiplier, and index in `parameters`.
    """

    force: str
    element: int
    parameters: np.ndarray
    side: int
    function: Callable[..., list[float]]
    multipliers: np.ndarray

    def values(self, observed: Observed, q: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> list[float]:
        """Return g in T states; see `mbdkit.engine.law_conditions.LawCondition.values`."""
        rows = zip(observed.forces, observed.lam, strict=True)
        return [self.function(*row[self.element, :2], *self.own(numbers, lam))[0] for row, lam in rows]

    def own(self, numbers: np.ndarray, lam: np.ndarray) -> np.ndarray:
        """Return the parameters (n, ...) of the law, given those of all laws (L, ...) and multipliers (P, 2, ...)."""
        pair, row, place = self.multipliers.T
        own = np.array(numbers[self.parameters])
        own[place] = lam[pair, row]
        return own


@dataclass(frozen=True)
class SidedMechanism:
    """A mechanism with sides; see the description of this module.

    Attributes
    ----------
    mechanism
        The compiled mechanism.
    conditions
        All conditions of its laws.
    places
        Indices in ``Topology.law_parameters`` of the parameters of the original laws.
    """

    mechanism: CompiledMechanism
    conditions: tuple[ForceCondition | LawCondition, ...]
    places: np.ndarray

    def seeds(self, seeds: Seeds) -> Seeds:
        """Return the derivatives of the arrays of this mechanism, given those of the original mechanism."""
        given = seeds.get("law_parameters")
        if given is None:
            return seeds
        own = np.zeros((len(self.mechanism.topology.law_parameters), seeds.count))
        own[self.places] = given
        return Seeds({**seeds.arrays, "law_parameters": own}, seeds.scale)


def with_sides(mechanism: CompiledMechanism) -> SidedMechanism | None:
    """Return a mechanism with sides; None if none of its laws has conditions."""
    sided = [_sided(one.law, tuple(name for name, _ in one.parameters)) for _, one in mechanism.laws]
    top = mechanism.topology
    values: list[float] = []
    places = np.zeros(len(top.law_parameters), dtype=np.int64)
    # A load that is an expression of the state shares its parameters with its derivatives.
    begins: dict[int, int] = {}
    conditions: list[ForceCondition | LawCondition] = []
    rows, laws = top.laws.copy(), list(mechanism.laws)
    elements = {int(spring[3]): int(top.force_place[k]) for k, spring in enumerate(top.springs) if spring[5] > 0}
    for row, ((name, compiled), own) in enumerate(zip(mechanism.laws, sided, strict=True)):
        begin = int(top.laws[row, LAW_ROW.parameters])
        given = top.law_parameters[begin : begin + 1 + int(top.law_parameters[begin])]
        if own is None or not own.conditions or row not in elements:
            if begin not in begins:
                begins[begin] = len(values)
                places[begin : begin + len(given)] = range(len(values), len(values) + len(given))
                values += given.tolist()
            rows[row, 1] = begins[begin]
            continue
        if np.sum(top.laws[:, LAW_ROW.parameters] == begin) > 1:
            raise refused(
                f"the law of the force '{name}' has first-order states and a discontinuity; gradients of such laws "
                f"are not available"
            )
        rows[row, 1] = len(values)
        sides = {SIDE.format(i): 1.0 for i in range(len(own.conditions))}
        named = zip((parameter for parameter, _ in compiled.parameters), given[1:].tolist(), strict=True)
        bound, _ = bind_law(own.law, dict(named) | sides, name)
        rows[row, LAW_ROW.address], rows[row, LAW_ROW.program], laws[row] = bound.address, bound.program, (name, bound)
        names = [parameter for parameter, _ in bound.parameters]  # in alphabetical order
        own_places = np.array([k for k, one in enumerate(names) if one not in sides], dtype=np.int64)
        held = np.ones(len(names))
        held[own_places] = given[1:]
        first = len(values) + 1
        multipliers = np.column_stack([top.reactions[:, :2], top.reactions[:, 2] - begin - 1])
        own_multipliers = multipliers[(multipliers[:, 2] >= 0) & (multipliers[:, 2] < len(own_places))]
        places[begin : begin + len(given)] = [first - 1, *(first + own_places).tolist()]
        for i, function in enumerate(own.conditions):
            side = first + names.index(SIDE.format(i))
            force = f"friction of {name}" if isinstance(own.law, TracedLaw) else name
            conditions.append(ForceCondition(force, elements[row], first + own_places, side, function, own_multipliers))
        values += [float(len(held)), *held.tolist()]

    def places_of(law: int) -> np.ndarray:
        begin = int(rows[law, 1])
        return np.arange(begin, begin + 1 + int(values[begin]))

    for handle, kind in mechanism.kinds():
        own_sides = kind.derivatives.sides
        conditions += () if own_sides is None else law_sides.of(own_sides)(handle, places_of)
    if not conditions:
        return None
    without_law = top.states[top.states[:, STATE_ROW.segment] < 0]
    for place in without_law[:, STATE_ROW.parameter].tolist():  # their initial values
        places[place - 1 : place + 1] = len(values), len(values) + 1
        values += top.law_parameters[place - 1 : place + 1].tolist()
    columns = {"inputs": 2, "states": 1, "state_places": 1, "reactions": 2}  # with indices of parameters of laws
    moved = {name: getattr(top, name).copy() for name in columns}
    for name, column in columns.items():
        moved[name][:, column] = places[moved[name][:, column]]
    own_top = top._replace(laws=rows, law_parameters=np.array(values), **moved)
    return SidedMechanism(replace(mechanism, topology=own_top, laws=tuple(laws)), tuple(conditions), places)


def with_unknown_corners(mechanism: CompiledMechanism) -> tuple[str, ...]:
    """Return the names of the forces whose laws are plugin functions, which may have unknown discontinuities."""
    return tuple(
        name
        for name, one in mechanism.laws
        if isinstance(one.law, FunctionLaw) and not one.law.function.__module__.startswith("mbdkit.laws.")
    )


def doubts_of_kinds(mechanism: CompiledMechanism) -> tuple[str, ...]:
    """Return what the kinds of elements doubt about derivatives of runs."""
    every = ((handle, kind.derivatives.doubts) for handle, kind in mechanism.kinds())
    return tuple(text for handle, doubts in every if doubts is not None for text in gradient_doubts.of(doubts)(handle))


@cache
def _sided(law: object, names: tuple[str, ...]) -> SidedLaw | None:
    """Return a law with sides; None if the law is neither an expression nor friction in a joint."""
    if law is PIN or law is SLIDE:
        return _sided_friction(law, names)
    if not isinstance(law, ExpressionLaw):
        return None
    import sympy as sp

    from mbdkit.symbolic.symbolic_law import smooth_pieces

    force, potential = smooth_pieces(law, names)
    variables = [sp.Symbol(name, real=True) for name in (*ARGUMENTS[:2], *names)]
    found: list[sympy.Expr] = []
    replaced: dict[object, object] = {}
    for relation in sorted(force.atoms(sp.core.relational.Relational), key=str):
        if not isinstance(relation, sp.Gt | sp.Ge | sp.Lt | sp.Le) or not relation.free_symbols & set(variables[:2]):
            continue  # only conditions on length or rate get sides
        g = sp.expand(relation.gts - relation.lts)
        if g.free_symbols - set(variables):
            continue
        sign = 1 if g in found else -1 if -g in found else 0
        if not sign:
            found.append(g)
            sign = 1
        side = sp.Symbol(SIDE.format(found.index(g if sign > 0 else -g)), real=True)
        replaced[relation] = sp.Gt(sign * side, 0)
        rate = variables[1]
        if rate in relation.free_symbols:  # the force at rate zero is the derivative of the potential for either side
            at_rest = relation.subs(rate, 0)
            replaced[relation] = sp.Or(sp.And(sp.Eq(rate, 0), at_rest), sp.And(sp.Ne(rate, 0), replaced[relation]))
    functions = tuple(
        sp.lambdify(variables, [g, *(sp.diff(g, variable) for variable in variables)], modules="math") for g in found
    )
    own_potential = None if law.potential is None else potential.xreplace(replaced)
    own = SwitchingLaw(force.xreplace(replaced), own_potential, passive=law.passive, parameters=_as_given)
    return SidedLaw(own, functions)


def _sided_friction(law: TracedLaw, names: tuple[str, ...]) -> SidedLaw:
    """Return the law of friction in a joint with sides (`SIDES`)."""

    def is_slipping(sign: float) -> Callable[..., list[float]]:
        def value_and_slopes(length: float, rate: float, *numbers: float) -> list[float]:
            p = dict(zip(names, numbers, strict=True))
            arm, by_arm = (p["arm"], sign * rate) if law is PIN else (1.0, 0.0)
            slopes = {"arm": by_arm, "transition": -1.0}
            return [sign * arm * rate - p["transition"], 0.0, sign * arm, *(slopes.get(name, 0.0) for name in names)]

        return value_and_slopes

    def is_pressed(sign: float) -> Callable[..., list[float]]:
        def value_and_slopes(length: float, rate: float, *numbers: float) -> list[float]:
            p = dict(zip(names, numbers, strict=True))
            arm, moment = sign * p["arm"], sign * p["reaction_1"]
            slopes = {"arm": moment, "reaction_0": 0.5, "reaction_1": arm}
            return [0.5 * p["reaction_0"] + p["arm"] * moment, 0.0, 0.0, *(slopes.get(name, 0.0) for name in names)]

        return value_and_slopes

    ends = (is_pressed(1.0), is_pressed(-1.0)) if law is SLIDE else ()
    return SidedLaw(replace(law, parameters=_as_given), (is_slipping(1.0), is_slipping(-1.0), *ends))


def _as_given(options: Mapping[str, float]) -> Mapping[str, float]:
    return options
