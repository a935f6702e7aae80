"""Assemble the symbolic equations of a mechanism, a `SymbolicSystem`, from the definitions of its elements.

Each joint lists its constraints by kind, so that a new joint type needs no change here. The generalized forces follow
from the virtual work of a force along a pathway, or of a load at a point.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache, partial
from typing import Any

import numpy as np
import sympy as sp
from sympy.core.function import UndefinedFunction

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import quoted
from mbdkit.expressions.parser import Expression
from mbdkit.mechanism.angle_function import Center, expression_of
from mbdkit.mechanism.beams import Beam
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.force_law import ExpressionLaw, law_parameters
from mbdkit.mechanism.forces import AppliedLoad, Force, PointForce, SpringDamper, Torque, TorsionSpring
from mbdkit.mechanism.joint_base import Constraint, PoseFunction
from mbdkit.mechanism.joints import force_of_reaction
from mbdkit.mechanism.law_element import Law
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.pathways import Pathway, Segment
from mbdkit.mechanism.state_values import is_of_state
from mbdkit.mechanism.values import Table, curve_of
from mbdkit.symbolic.symbolic_function import symbolic_function
from mbdkit.symbolic.symbolic_law import law_force
from mbdkit_statics import element_definitions as d
from mbdkit_statics.symbolic_system import SymbolicSystem

TIME = sp.Symbol("t", real=True)

Jet = tuple[sp.Expr, sp.Expr, sp.Expr]  #: A motion and its first two time derivatives.

#: Symbol name and LaTeX of common parameters of laws. For any other parameter, the symbol is named after the option.
_LETTERS = {"stiffness": ("k", "k"), "damping": ("c", "c"), "free_length": ("l", r"\ell")}

_KINKED = (sp.Abs, sp.Min, sp.Max)


def build_system(mechanism: Mechanism, *, numbers: bool) -> SymbolicSystem:
    """Return the index-1 system of a mechanism.

    Parameters
    ----------
    numbers
        Whether masses, lengths and other parameters are inserted as numbers instead of symbols.

    Raises
    ------
    SpecError
        If the mechanism is not valid, or a force has no symbolic form.
    """
    mechanism.validate()
    further = [kind for kind in mechanism.elements if kind not in ("joints", "forces", "markers")]
    further = [*(kind for kind in ("states", "inputs") if getattr(mechanism, kind)), *further]
    if kind := next(iter(further), ""):
        what = "first-order states" if kind == "states" else kind
        raise SpecError(f"{what} have no symbolic form", key=f"model.{kind}")
    if force := force_of_reaction(mechanism.joints):
        key, what, remedy = force
        raise SpecError(f"{what} has no symbolic form; {remedy}", key=f"model.joints.{key}")
    return _SystemBuilder(mechanism, numbers).system()


class _SystemBuilder:
    def __init__(self, mechanism: Mechanism, numbers: bool):
        self.mechanism, self.numbers = mechanism, numbers
        self.names: dict[sp.Symbol, str] = {TIME: "t"}
        self.parameters: dict[sp.Symbol, float] = {}
        self.functions: set[str] = set()
        self.known: dict[tuple[float, str, tuple[str, ...]], sp.Symbol] = {}
        self.bodies = [*mechanism.bodies, GROUND]
        letters = (("x", "x"), ("y", "y"), ("theta", r"\theta"))
        self.q, self.v, self.a = (
            [
                self.symbol(f"{letter}{dots}_{body}", f"{accent % tex}_{{{_text(body)}}}")
                for body in mechanism.bodies
                for letter, tex in letters
            ]
            for dots, accent in (("", "%s"), ("dot", r"\dot{%s}"), ("ddot", r"\ddot{%s}"))
        )
        self.forces = [sp.Integer(0)] * len(self.q)

    def system(self) -> SymbolicSystem:
        mass = self.masses_and_gravity()
        for name, force in self.mechanism.forces.items():
            self.add_force(name, force)
        for name, beam in self.mechanism.beams.items():
            self.add_beam(name, beam)
        constraints, jacobian, gamma, multipliers = self.constraints()
        matrices = {
            "mass_matrix": sp.ImmutableMatrix(sp.diag(*mass)),
            "constraints": _column(constraints),
            "constraint_jacobian": sp.ImmutableMatrix(len(jacobian), len(self.q), [x for row in jacobian for x in row]),
            "gamma": _column(gamma),
            "forces": _column(self.forces),
        }
        used = set().union(*(matrix.free_symbols for matrix in matrices.values()))
        unused = [symbol for symbol in self.parameters if symbol not in used]
        return SymbolicSystem(
            t=TIME,
            q=_column(self.q),
            v=_column(self.v),
            accelerations=_column(self.a),
            multipliers=_column(multipliers),
            parameters={symbol: value for symbol, value in self.parameters.items() if symbol in used},
            names={symbol: tex for symbol, tex in self.names.items() if symbol not in unused},
            **matrices,
        )

    # ---- symbols -------------------------------------------------------------------------------------------------

    def symbol(self, name: str, tex: str) -> sp.Symbol:
        """Return a new real symbol; primes are appended to `name` until it is unique.

        Names of bodies with underscores can produce the same symbol name twice.
        """
        symbol = sp.Symbol(name, real=True)
        while symbol in self.names:
            name, tex = f"{name}'", f"{{{tex}}}'"
            symbol = sp.Symbol(name, real=True)
        self.names[symbol] = tex
        return symbol

    def parameter(self, value: float, letter: str, *owners: str, tex: str = "") -> sp.Expr:
        """Return a parameter as a number, as which zero is always returned, or as a symbol with its owners as index.

        In directions, 1 is a number, too.
        """
        if self.numbers or value == 0 or (letter in ("e_x", "e_y") and abs(value) == 1.0):
            return _number(value)
        key = (value, letter, owners)
        if key not in self.known:
            index = f"_{{{','.join(_text(owner) for owner in owners)}}}" if owners else ""
            self.known[key] = self.symbol("_".join((letter, *owners)), (tex or letter) + index)
            self.parameters[self.known[key]] = float(value)
        return self.known[key]

    def point(self, name: str, body: str, point: Sequence[float]) -> list[sp.Expr]:
        """Return the coordinates of a point in a body's frame."""
        return [
            self.parameter(x, letter, name, body, tex=rf"\{letter}")
            for x, letter in zip(point, ("xi", "eta"), strict=True)
        ]

    # ---- elements ------------------------------------------------------------------------------------------------

    def masses_and_gravity(self) -> list[sp.Expr]:
        """Return the diagonal of the mass matrix; add the gravity forces to `forces`."""
        x, y = self.mechanism.gravity
        if x == 0 and y < 0:
            gravity = (sp.Integer(0), -self.parameter(-y, "g"))
        else:
            gravity = (self.parameter(x, "g_x"), self.parameter(y, "g_y"))
        diagonal: list[sp.Expr] = []
        for i, (name, body) in enumerate(self.mechanism.bodies.items()):
            mass = self.parameter(body.mass, "m", name)
            inertia = sp.Integer(1) if body.inertia is None else self.parameter(body.inertia, "J", name)
            diagonal += [mass, mass, inertia]
            for axis in range(2):
                self.forces[3 * i + axis] += mass * gravity[axis]
        return diagonal

    def constraints(self) -> tuple[list[sp.Expr], list[list[sp.Expr]], list[sp.Expr], list[sp.Symbol]]:
        """Return Phi, the rows of Phi_q, gamma and the multipliers, in the order of the constraint labels."""
        constraints, jacobian, gamma, multipliers = [], [], [], []
        for name, joint in self.mechanism.joints.items():
            a, b = (self.bodies.index(body) for body in joint.bodies)
            for constraint in self.mechanism.constraints_of(name):
                terms = _constraint_terms(constraint.kind)
                jet = None if constraint.motion is None else _jet(constraint.motion)
                parameters = self.constraint_parameters(name, joint.bodies, constraint)
                here = self.values(a, b, parameters, jet, constraint.center)
                if constraint.function is not None:
                    here |= self.function_values(name, constraint.function, here)
                for index in range(constraint.rows):
                    constraints.append(terms["phi"][index].xreplace(here))
                    gamma.append(terms["gamma"][index].xreplace(here))
                    whole = [sp.Integer(0)] * len(self.q)
                    self.spread([x.xreplace(here) for x in terms["jacobian"].row(index)], a, b, whole)
                    jacobian.append(whole)
                    label = joint.rows[constraint.first_row + index]
                    shown = label if len(label) == 1 else _text(label)
                    multipliers.append(self.symbol(f"lambda_{name}_{label}", rf"\lambda_{{{_text(name)},{shown}}}"))
        return constraints, jacobian, gamma, multipliers

    def constraint_parameters(self, joint: str, bodies: tuple[str, str], one: Constraint) -> list[sp.Expr]:
        """Return the parameters p0 to p5 of a constraint."""
        first, second = bodies
        parameters = [*self.point(joint, first, one.points[:2]), *self.point(joint, second, one.points[2:])]
        named = _kind(one.kind).constants
        for i, x in enumerate(one.constants):
            letter, tex = named[i] if i < len(named) else (f"p{i + 4}", f"p^{{({i + 4})}}")
            parameters.append(self.parameter(x, letter, joint, tex=tex))
        return parameters

    def function_values(
        self, joint: str, function: PoseFunction, here: dict[sp.Symbol, sp.Expr]
    ) -> dict[sp.Symbol, sp.Expr]:
        """Return a function of the pose and its derivatives, given the other symbols of the definitions."""
        given = {
            letter: _angle(value) if self.numbers else self.parameter(value, letter, joint, tex=_text(letter))
            for letter, value in function.parameters
        }
        x, y, angle, first = sp.symbols("x y angle first", real=True)
        with SpecError.locate(f"model.joints.{quoted(joint)}"):
            values = symbolic_function(
                function, joint, (x, y, angle, first, TIME), given, _angle, partial(self.table, joint, {})
            )
        pose = {
            x: (d.in_x - d.PARAMETERS[0]).xreplace(here),
            y: (d.in_y - d.PARAMETERS[1]).xreplace(here),
            angle: (d.thb - d.tha).xreplace(here),
            first: d.tha.xreplace(here),
        }
        return {symbol: value.xreplace(pose) for symbol, value in zip(d.FUNCTION.values(), values, strict=False)}

    def add_force(self, name: str, force: Force) -> None:
        """Add the generalized forces of a force element."""
        match force:
            case SpringDamper() | TorsionSpring():
                self.add_spring(name, force)
            case Law():
                self.add_law(name, force)
            case Torque() | PointForce():
                self.add_load(name, force.load)
            case _:
                raise SpecError(f"a {force.type} has no symbolic form", key=f"model.forces.{quoted(name)}")

    def add_load(self, name: str, load: AppliedLoad) -> None:
        """Add the generalized forces of a load."""
        if any(map(is_of_state, load.values)):
            raise SpecError("an expression of the state has no symbolic form", key=f"model.forces.{quoted(name)}.value")
        values = [_jet(x)[0] for x in load.values]
        if load.kind == "torque":
            *_, gradient = _pathway_terms("relative_angle")
            self.add(gradient.T * values[0], load.reaction_body, load.body, [])
            return
        place = d.jacobian((d.xb + d.bx, d.yb + d.by), d.BODY_COORDINATES)
        value = sp.Matrix(values)
        if load.kind == "body_force":
            value = sp.Matrix([[d.cb, -d.sb], [d.sb, d.cb]]) * value
        held = [sp.Integer(0)] * 2 + self.point(name, load.body, load.point)
        self.add(place.T * value, load.reaction_body, load.body, held)

    def add_spring(self, name: str, force: SpringDamper | TorsionSpring) -> None:
        """Add a linear spring and damper along a pathway of length s.

        The tension F = k (s - s_0) + c s' gives the generalized forces Q = -F s_q.
        """
        letter, tex = ("l", r"\ell") if force.length_unit == "m" else ("phi", r"\varphi")
        free = self.parameter(force.linear.free, letter, name, tex=tex)
        stiffness, damping = self.parameter(force.stiffness, "k", name), self.parameter(force.damping, "c", name)
        self.add_tension(name, force, lambda length, rate: stiffness * (length - free) + damping * rate)

    def add_law(self, name: str, force: Law) -> None:
        """Add the generalized forces Q = -F s_q of a law that gives the force F along its pathway of length s.

        F is an expression if the law is an `ExpressionLaw`; for other laws it is an undefined function of length, rate
        and time.
        """
        law = force.force_law
        if law.states:
            raise SpecError("first-order states have no symbolic form", key=f"model.forces.{quoted(name)}")
        names, values = law_parameters(law, force, force.law_id)
        if not isinstance(law, ExpressionLaw):
            function = self.numeric_law(name, law.function, np.array(values))
            self.add_tension(name, force.pathway, lambda length, rate: function(length, rate, TIME))
            return
        known: dict[str, sp.Expr] = {}
        for option, value in zip(names, values, strict=True):
            letter, tex = _LETTERS.get(option, (option, _text(option)))
            known[option] = self.parameter(value, letter, name, tex=tex)
        self.add_tension(name, force.pathway, lambda length, rate: law_force(law, known, length, rate, TIME))

    def add_tension(
        self, name: str, pathway: Pathway | SpringDamper | TorsionSpring, tension: Callable[[sp.Expr, sp.Expr], sp.Expr]
    ) -> None:
        """Add the generalized forces -F s_q of a tension F on the bodies of every segment of a pathway of length s.

        F is a function of the length of the whole pathway and of the rate of this length.
        """
        parts = [(one, self.segment_parameters(name, one)) for one in pathway.segments(self.mechanism.joints)]
        whole = [self.segment_length(*part) for part in parts]
        for index, (segment, parameters) in enumerate(parts):
            length, rate, gradient = _pathway_terms(segment.kind)
            for other, (further_length, further_rate) in enumerate(whole):
                if other != index:
                    length, rate = length + further_length, rate + further_rate
            self.add(-tension(length, rate) * gradient.T, *segment.bodies, parameters)

    def segment_parameters(self, name: str, segment: Segment) -> list[sp.Expr]:
        """Return the parameters p0 to p5 of a segment of the pathway of force element `name`."""
        (a, b), points = segment.bodies, segment.points
        named = next(one.constants for one in d.PATHWAYS if one.name == segment.kind)
        constants = [
            self.parameter(x, letter, name, b, tex=tex)
            for x, (letter, tex) in zip(segment.constants, named, strict=False)
        ]
        return [*self.point(name, a, points[:2]), *self.point(name, b, points[2:]), *constants]

    def segment_length(self, segment: Segment, parameters: Sequence[sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        """Return the length of a segment and its rate, in the symbols of the mechanism."""
        length, rate, _ = _pathway_terms(segment.kind)
        a, b = segment.bodies
        here = self.values(self.bodies.index(a), self.bodies.index(b), parameters)
        return length.xreplace(here), rate.xreplace(here)

    def numeric_law(self, name: str, function: Any, parameters: np.ndarray) -> Any:
        """Return the force of a law as an undefined function of length, rate and time that evaluates numerically."""

        def force(length: float, rate: float, time: float) -> float:
            return float(function(length, rate, time, parameters)[0])

        return self.undefined(f"F_{name}", f"F_{{{_text(name)}}}", force)

    def undefined(self, word: str, tex: str, function: Callable[..., float]) -> Any:
        """Return an undefined function that evaluates numerically."""

        def latex(term: Any, printer: Any, exp: str | None = None) -> str:
            shown = rf"{tex}\left({', '.join(printer._print(x) for x in term.args)}\right)"
            return shown if exp is None else rf"{{{shown}}}^{{{exp}}}"

        word = re.sub(r"\W", "_", word)
        while word in self.functions:
            word += "_"
        self.functions.add(word)
        return UndefinedFunction(word, __dict__={"_imp_": staticmethod(function), "_latex": latex})

    def table(
        self, joint: str, known: dict[tuple[int, int], Any], function: Callable[[float], float], table: int, order: int
    ) -> Any:
        """Return a derivative of a table of a joint as an undefined function."""
        if (table, order) not in known:
            index = _text(joint) + (f",{table + 1}" if table else "")
            tex = rf"f_{{{index}}}" + (rf"^{{({order})}}" if order else "")
            known[table, order] = self.undefined(f"f_{joint}_{table}_{order}", tex, function)
        return known[table, order]

    def add(self, terms: sp.Matrix, a: str, b: str, parameters: Sequence[sp.Expr]) -> None:
        """Add generalized forces (6, 1), given in the symbols of the definitions, to those of bodies `a` and `b`."""
        first, second = self.bodies.index(a), self.bodies.index(b)
        here = self.values(first, second, parameters)
        self.spread([_shortest(x).xreplace(here) for x in terms], first, second, self.forces)

    def add_beam(self, name: str, beam: Beam) -> None:
        """Add the forces of a beam on its nodes.

        Each cross-section contributes the force conjugate to its state, which the shape functions distribute to the
        nodes.
        """
        stiffness = zip(d.SECTION_STIFFNESS, beam.element_stiffness, ("EA", "GA", "EI"), strict=True)
        held = {symbol: self.parameter(k, letter, name) for symbol, k, letter in stiffness}
        retardation = self.parameter(beam.damping, "tau", name, tex=r"\tau")
        held |= {c: retardation * held[k] for c, k in zip(d.SECTION_DAMPING, d.SECTION_STIFFNESS, strict=True)}
        force = _section_terms()
        for section in beam.sections(name):
            nodes = [self.bodies.index(node) for node in section.nodes]
            shapes = [[_number(x) for x in values] for values in (section.shape, section.slope)]
            here = held | {d.SECTION_LENGTH: _number(section.length)}
            here |= zip(d.SECTION_REFERENCE, map(_number, section.reference), strict=True)
            for symbols, whole in ((d.SECTION, self.q), (d.SECTION_RATES, self.v)):
                here |= zip(symbols, _section_state(whole, nodes, *shapes), strict=True)
            angle = here[d.SECTION[2]]
            here |= {d.c: sp.cos(angle), d.s: sp.sin(angle)}
            here |= {symbol: d.INTERMEDIATES[symbol].xreplace(here) for symbol in (d.along, d.across)}
            x, y, turn, bend = (one.xreplace(here) for one in force)
            for node, shape, slope in zip(nodes, *shapes, strict=True):
                for axis, one in enumerate((slope * x, slope * y, shape * turn + slope * bend)):
                    self.forces[3 * node + axis] -= one

    # ---- symbols of the definitions replaced by those of the mechanism ---------------------------------------------

    def values(
        self, a: int, b: int, parameters: Sequence[sp.Expr], motion: Jet | None = None, center: Center | None = None
    ) -> dict[sp.Symbol, sp.Expr]:
        """Return a mapping from each symbol of the definitions to its expression in an element between bodies `a` and
        `b`.
        """
        at_rest = [sp.Integer(0)] * 3
        q, v = (
            [x for body in (a, b) for x in (whole[3 * body : 3 * body + 3] or at_rest)] for whole in (self.q, self.v)
        )
        values: dict[sp.Symbol, sp.Expr] = dict(zip(d.BODY_COORDINATES, q, strict=True))
        values |= zip(d.BODY_VELOCITIES, v, strict=True)
        values |= {d.ca: sp.cos(q[2]), d.sa: sp.sin(q[2]), d.cb: sp.cos(q[5]), d.sb: sp.sin(q[5])}
        values |= zip(d.PARAMETERS, parameters, strict=False)
        if motion is not None:
            values |= zip(d.MOTION, motion, strict=True)
        if center is not None:  # whose displacement, and derivatives of it, are functions of the relative angle
            for symbols, (_, function) in zip(d.CENTER, center.functions, strict=True):
                jet = _jet(function, expression_of)
                values |= {symbol: x.xreplace({TIME: q[5] - q[2]}) for symbol, x in zip(symbols, jet, strict=False)}
        for symbol, expr in d.INTERMEDIATES.items():
            values[symbol] = expr.xreplace(values)
        return values

    def spread(self, terms: Sequence[sp.Expr], a: int, b: int, whole: list[sp.Expr]) -> None:
        """Add six terms to the columns of bodies `a` and `b` in a row `whole` (n,) of the system; ground has no
        columns.
        """
        for i, term in enumerate(terms):
            place = 3 * (a, b)[i // 3] + i % 3
            if place < len(whole):
                whole[place] += term


def _kind(name: str) -> d.ConstraintKind:
    return next(one for one in d.CONSTRAINTS if one.name == name)


@cache
def _constraint_terms(kind: str) -> dict[str, sp.Matrix]:
    """Return ``phi``, ``jacobian`` and ``gamma`` of a constraint kind in the symbols of the definitions."""
    derived = d.derive_constraint(_kind(kind))
    return {name: derived[name].applyfunc(_shortest) for name in ("phi", "jacobian", "gamma")}


@cache
def _pathway_terms(kind: str) -> tuple[sp.Expr, sp.Expr, sp.Matrix]:
    """Return length, rate and gradient (1, 6) of the length of a pathway in the symbols of the definitions."""
    derived = d.derive_pathway(next(one for one in d.PATHWAYS if one.name == kind))
    return derived["length"][0], (derived["gradient"] * sp.Matrix(d.BODY_VELOCITIES))[0], derived["gradient"]


@cache
def _section_terms() -> sp.Matrix:
    """Return the force (4, 1) conjugate to the state of a cross-section, in the symbols of the definitions."""
    return d.derive_section()["force"]


def _section_state(
    whole: Sequence[sp.Expr], nodes: Sequence[int], shape: Sequence[sp.Expr], slope: Sequence[sp.Expr]
) -> tuple[sp.Expr, ...]:
    x, y, angle = ([whole[3 * node + axis] for node in nodes] for axis in range(3))
    return tuple(
        sum((w * value for w, value in zip(weights, values, strict=True)), sp.Integer(0))
        for weights, values in ((slope, x), (slope, y), (shape, angle), (slope, angle))
    )


def _shortest(expr: sp.Expr) -> sp.Expr:
    """Return the form of an expression with the fewest operations: as given, expanded, or factored."""
    return min((expr, sp.expand(expr), sp.factor_terms(sp.expand(expr))), key=sp.count_ops)


def _column(entries: Sequence[sp.Expr]) -> sp.ImmutableMatrix:
    return sp.ImmutableMatrix(len(entries), 1, list(entries))


def _number(value: float) -> sp.Expr:
    value = float(value)
    return sp.Integer(int(value)) if value.is_integer() else sp.Float(repr(value), 17)


def _jet(motion: Any, parse: Callable[[str], Expression] = Expression.parse) -> Jet:
    """Return value and first two time derivatives of a motion, which is a number, an expression in t, or a table."""
    if isinstance(motion, Table):
        value = _spline(motion)
        jet = value, value.diff(TIME), value.diff(TIME, 2)
        if not motion.period:
            return jet
        first = _number(motion.table[0][0])
        within = first + sp.Mod(TIME - first, _number(motion.period))  # the time, shifted into the first period
        return tuple(one.xreplace({TIME: within}) for one in jet)
    if not isinstance(motion, str):
        return _number(motion), sp.Integer(0), sp.Integer(0)
    value = parse(motion).to_sympy()
    value = value.xreplace({x: _angle(float(x)) for x in value.atoms(sp.Float)})
    smooth = value.rewrite(sp.Piecewise) if value.has(*_KINKED) else value
    return value, smooth.diff(TIME), smooth.diff(TIME, 2)


def _spline(table: Table) -> sp.Expr:
    """Return the piecewise polynomial of a table, whose first and last pieces also extrapolate."""
    curve = curve_of(table)
    times = curve.x.tolist()
    degree = len(curve.c) - 1
    pieces = []
    for begin, end, coefficients in zip(times, times[1:], curve.c.T, strict=False):
        piece = sum(_number(c) * (TIME - _number(begin)) ** (degree - i) for i, c in enumerate(coefficients))
        pieces.append((piece, sp.true if end == times[-1] else sp.Lt(TIME, _number(end))))
    return sp.Piecewise(*pieces)


def _angle(value: float) -> sp.Expr:
    """Return a number as a simple fraction of pi if the two agree within one ulp, otherwise as a decimal."""
    part = Fraction(value / math.pi).limit_denominator(12)
    if part and abs(value - float(part) * math.pi) <= math.ulp(value):
        return sp.Rational(part.numerator, part.denominator) * sp.pi
    return _number(value)


_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: rf"\{letter}" for letter in "{}$&#_%"},
}


def _text(name: str) -> str:
    """Return a name as text for use within LaTeX mathematics."""
    return rf"\text{{{''.join(_SPECIAL.get(letter, letter) for letter in name)}}}"
