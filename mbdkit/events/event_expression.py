"""Event expressions of time, bodies, joints and energies, parsed by an extension of the parser for expressions of time.

In addition to ``t``, ``pi``, numbers, operators and functions, an expression can contain the quantities that
`mbdkit.quantities.table.quantities_of_events` lists. They are in SI units and have the values recorded in the archive;
accelerations and reactions are the index-1 values at the state. For a joint, ``force`` is the magnitude of the reaction
force, and ``force_first_x`` the component of this force along the x axis of the first body. ``angle`` is the angle of
the second body relative to the first or, for a slide, the travel. Write ``bodies.NAME`` or ``joints.NAME`` if a body
and a joint have the same name, and ``bodies["NAME"]`` if the name is not an identifier.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, NoReturn

from mbdkit.base import elementary
from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.text import did_you_mean, listed
from mbdkit.expressions.operations import OPERATIONS
from mbdkit.expressions.parser import Code, Compiler
from mbdkit.expressions.program import Program, execute
from mbdkit.mechanism.beams import last_nodes
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.element_kinds import element_kinds
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.mechanism.mechanism_seams import member_names
from mbdkit.quantities.array import Kind
from mbdkit.quantities.quantity import Quantity
from mbdkit.quantities.registered_kinds import added_kinds, item_of_group, kind_of_word, words
from mbdkit.quantities.table import KINDS
from mbdkit.registry.accessors import accessors

#: Kinds of the core that have quantities in expressions.
_WORDS = tuple(kind.word for kind in KINDS if kind.example)
#: Kinds of elements whose quantities may be written without the kind, as NAME.ATTRIBUTE.
_BARE = tuple(kind.word for kind in KINDS if kind.example and kind.is_bare)
_ANGLES = ("angle", "angular_velocity", "angular_acceleration")

#: A function of the time and the quantities in an expression: numbers, or arrays.
Function = Callable[[Sequence[Any]], Any]


class CompiledExpression(NamedTuple):
    """An expression as a function, with functions that determine how densely it must be sampled.

    - `value`: the expression.
    - `phases`: arguments of the periodic functions in the expression.
    - `breaks`: functions at whose zeros the expression has kinks, zeros or poles: arguments of ``abs``, differences of
      the operands of ``min`` and ``max``, and the factors of a product or quotient.
    - `is_product`: whether the expression is a product or quotient, whose sign changes are those of `breaks`.
    """

    value: Function
    phases: tuple[Function, ...]
    breaks: tuple[Function, ...]
    is_product: bool


@dataclass(frozen=True)
class RunExpression:
    """A scalar function of the state and time of a run, whose zero crossings are events.

    `text`: the expression as written by the user. `program`: instructions as in `mbdkit.expressions.program`, and
    ``get``, which pushes the quantity with the given index in `quantities`. `quantities`: quantities in the expression,
    except time.
    """

    text: str
    program: Program
    quantities: tuple[Quantity, ...]

    @staticmethod
    def parse(
        text: str, mechanism: Mechanism, parameters: Mapping[str, float] | None = None, *, crosses: bool = True
    ) -> RunExpression:
        """Parse an expression of quantities of a mechanism and of named parameters.

        If `crosses` is set, the expression must be able to cross zero.

        Raises SpecError if the syntax is wrong, a quantity does not exist, or the expression cannot cross zero although
        it must.
        """
        compiler = RunCompiler(text, mechanism, parameters)
        program = tuple(compiler.program())
        if crosses:
            _check_crossing(program, compiler.quantities)
        return RunExpression(text, program, tuple(compiler.quantities))

    def function(self, places: Mapping[Quantity, int]) -> Callable[[Sequence[float]], float]:
        """Return a function that evaluates the expression; it returns nan where the expression is undefined.

        `places`: index of each quantity in the argument of the function; index 0 is the time.
        """
        return self.compiled(places).value

    def compiled(self, places: Mapping[Quantity, int], *, of_arrays: bool = False) -> CompiledExpression:
        """Return the expression, with the parts that determine how densely it must be sampled; see `function`.

        If `of_arrays`, the functions receive and return arrays, except that constants return numbers.
        """
        phases: list[Function] = []
        breaks: list[Function] = []
        factors: dict[Function, list[Function]] = {}

        def step(name: str, number: float, *operands: Function) -> Function:
            if name == "const":
                return lambda values: number
            if name == "t":
                return operator.itemgetter(0)
            if name == "get":
                return operator.itemgetter(places[self.quantities[int(number)]])
            operation = OPERATIONS[name]
            if operation.is_periodic:
                phases.append(_total(*operands))
            if operation.switch and not operation.jumps:
                is_first = operation.switch == "first"
                breaks.append(_total(operands[0] if is_first else _applied(operator.sub, *operands)))
            if name == "powi":
                result = _applied(lambda base: elementary.pow(base, number), *operands)
            else:
                result = _applied(operation.array if of_arrays else operation.number, *operands)
            if name in ("mul", "div", "neg", "powi"):
                factors[result] = [factor for operand in operands for factor in factors.get(operand, [operand])]
            return result

        whole = execute(self.program, step)
        breaks += map(_total, factors.get(whole, []))
        return CompiledExpression(_total(whole), tuple(phases), tuple(breaks), whole in factors)


def places_of(expressions: Iterable[RunExpression]) -> dict[Quantity, int]:
    """Return the index of each quantity of expressions in the argument of their functions; index 0 is the time."""
    quantities = dict.fromkeys(quantity for expression in expressions for quantity in expression.quantities)
    return {quantity: index for index, quantity in enumerate(quantities, start=1)}


def _applied(function: Callable[..., object], of: Function, other: Function | None = None) -> Function:
    if other is None:
        return lambda values: function(of(values))
    return lambda values: function(of(values), other(values))


def _total(function: Function) -> Function:
    """Return a function that is nan where `function` is undefined, such as at the square root of a negative number, or
    a number that is too large.
    """

    def evaluated(values: Sequence[object]) -> object:
        try:
            value = function(values)
        except (ArithmeticError, ValueError):
            return math.nan
        return math.nan if isinstance(value, float) and math.isinf(value) else value

    return evaluated


def _check_crossing(program: Program, quantities: Sequence[Quantity]) -> None:
    last, number = program[-1]
    if len(program) == 1 and last == "const":
        raise SpecError(
            f"the expression is the constant {number:.6g}, which never crosses zero; use a quantity of the run in it, "
            "such as NAME.angle of a body"
        )
    alone = quantities[0] if len(program) == 1 and last == "get" else None
    if (alone is not None and (alone.is_vector or alone.recorded.array.is_not_negative)) or (
        (last in OPERATIONS and OPERATIONS[last].is_never_negative) or (last == "powi" and int(number) % 2 == 0)
    ):
        raise SpecError(
            "the expression is never negative, so it cannot cross zero; subtract the threshold of the event from it"
        )


def check_state(name: str, mechanism: Mechanism) -> None:
    """Raise SpecError if neither a first-order state nor an output or state of a controller has this name."""
    known = [*mechanism.state_names(), *mechanism.held_names()]
    if name not in known:
        some = f"; there are {listed(known[:6])}{', ...' * (len(known) > 6)}" if known else "; the mechanism has none"
        raise SpecError(f"there is no first-order state '{name}'{did_you_mean(name, known) or some}")


class WordsOfKinds(Mapping[str, Sequence[str]]):
    """Names of the quantities of each kind by its word; plugins are imported for the words that are looked up.

    `names`: function that returns the names of a kind. `more`: names by further words.
    """

    def __init__(
        self, names: Callable[[Kind], Sequence[str]], more: Mapping[str, Sequence[str]] = MappingProxyType({})
    ):
        self._names, self._more = names, more

    def __getitem__(self, word: str) -> Sequence[str]:
        if word in self._more:
            return self._more[word]
        if word not in words() or not (kind := kind_of_word(word)).attributes:
            raise KeyError(word)
        return self._names(kind)

    def __iter__(self) -> Iterator[str]:
        every = dict.fromkeys([*words(), *self._more])
        return (word for word in every if word in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)


@cache
def _words_of_mechanisms() -> tuple[str, ...]:
    empty = Mechanism()
    return tuple(word for word in _WORDS if hasattr(empty, word))


class RunCompiler(Compiler):
    """Compiles one expression with the quantities of a run.

    `attributes`: names of the quantities of each kind of element.
    """

    attributes: ClassVar[Mapping[str, Sequence[str]]] = WordsOfKinds(
        lambda kind: [name for name, quantity in kind.attributes.items() if quantity.in_events]
    )
    wanted = (
        "an expression of a run, which has numbers, t, pi, NAME.ATTRIBUTE of bodies and joints, forces.NAME.value, "
        "markers.NAME.x, beams.NAME.moment[0], energy.total"
    )

    def __init__(self, text: str, mechanism: Mechanism, parameters: Mapping[str, float] | None = None):
        self.mechanism = mechanism
        self.known = {word: list(getattr(mechanism, word)) for word in _words_of_mechanisms()}
        self._last = last_nodes(mechanism.beams)
        self.known["states"] = [*mechanism.state_names(), *mechanism.held_names()]
        for own in map(item_of_group, added_kinds()):
            elements = self.known.get(own.of)
            if elements is None and (own.of in element_kinds() or own.of in accessors(type(mechanism))):
                elements = getattr(mechanism, own.of)
            if own.word and elements is not None:
                own_names = elements if own.names is None or not elements else member_names.of(own.names)(mechanism)
                self.known[own.word] = list(own_names)
        self.quantities: list[Quantity] = []
        self.quoted = {name: kind for kind, names in self.known.items() for name in names if not name.isidentifier()}
        if self.quoted:
            self.hint = self.spelling(next(iter(self.quoted)))
        super().__init__(text, parameters)

    def operand(self, node: ast.expr) -> Code:
        """Return the program of a quantity."""
        match node:
            case ast.Subscript(ast.Attribute() as whole, index) if (parts := self.path(whole)) and parts[0] == "beams":
                return self.of_element(parts[1], parts[2], index, node)
            case ast.Attribute(ast.Name(id="states" | "inputs" as word), attr=name) | ast.Subscript(
                ast.Name(id="states" | "inputs" as word), ast.Constant(value=str() as name)
            ):
                return self.of(word, name, "value", node)
            case ast.Attribute(ast.Attribute(ast.Name(id="controllers"), attr=name), attr=value) | ast.Attribute(
                ast.Subscript(ast.Name(id="controllers"), ast.Constant(value=str() as name)), attr=value
            ):
                return self.of_controller(name, value, node)
            case ast.Attribute(value=ast.Name(id="energy"), attr=attribute):
                return self.get(Quantity("energy", "", self.checked(attribute, ["energy"], "", node)))
            case ast.Attribute() if parts := self.path(node):
                return self.of(*parts, node)
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if name not in self.known or self.kinds(name):
                return self.of(self.kind(name, attribute, node), name, attribute, node)
            case ast.Name(id=group) if group in self.attributes:
                example = f"{group}.{'NAME.' * (group in self.known)}{kind_of_word(group).example}"
                self.refuse(f"'{group}' is not a quantity by itself; write {example}, for example", node)
            case ast.Name(id=name) if any(name in names for names in self.known.values()):
                kind = next(kind for kind, names in self.known.items() if name in names)
                example = f"{'' if kind in _BARE else f'{kind}.'}{name}.{kind_of_word(kind).example}"
                noun = kind_of_word(kind).one
                self.refuse(f"'{name}' is a {noun}, not a number; use one of its quantities, such as {example}", node)
            case ast.Name(id=name) if meant := [quoted for quoted in self.quoted if re.match(rf"{name}\W", quoted)]:
                self.refuse(f"unknown name '{name}'{self.spelling(meant[0])}", node)
            case ast.Attribute() if right := self.with_quotes(ast.unparse(node)):
                self.refuse(f"'{ast.unparse(node)}' contains a name with a dot, which needs quotes: {right}", node)
        return super().operand(node)

    def with_quotes(self, text: str) -> str:
        """Return a quantity such as ``joints.R.knee.force`` with its name in quotes; empty if no name is found."""
        kind, _, rest = text.partition(".")
        for word, path in [(kind, rest)] if kind in self.known else [(word, text) for word in self.known]:
            for name in self.known[word]:
                if "." in name and path.startswith(f"{name}."):
                    return f'{word}["{name}"]{path.removeprefix(name)}'
        return ""

    def path(self, node: ast.Attribute) -> tuple[str, str, str] | None:
        """Return kind, name and attribute of ``KIND.NAME.ATTRIBUTE`` or ``KIND["NAME"].ATTRIBUTE``; None otherwise."""
        match node.value:
            case ast.Attribute(ast.Name(id=kind), attr=name) if kind in self.known:
                return kind, name, node.attr
            case ast.Subscript(ast.Name(id=kind), ast.Constant(value=str() as name)) if kind in self.known:
                return kind, name, node.attr
        return None

    def spelling(self, name: str) -> str:
        """Return a hint on how to write a name that is not an identifier."""
        return f"; a name such as {name!r} is written {self.quoted[name]}[{name!r}]"

    def kind(self, name: str, attribute: str, node: ast.expr) -> str:
        """Return the kind, ``bodies`` or ``joints``, to which a name refers."""
        if not (kinds := self.kinds(name)):
            if other := next((kind for kind, names in self.known.items() if name in names), ""):
                fits = attribute in self.attributes.get(other, ())
                example = f"{other}.{name}.{attribute if fits else kind_of_word(other).example}"
                self.refuse(f"'{name}' is a {kind_of_word(other).one}; write {example}", node)
            self.unknown(name, [*self.known["bodies"], *self.known["joints"]], "body or joint", node)
        fitting = [kind for kind in kinds if self.checked(attribute, kinds, name, node) in self.attributes[kind]]
        if len(fitting) > 1:
            both = " or ".join(f"{kind}.{name}.{attribute}" for kind in fitting)
            self.refuse(f"'{name}' is both a body and a joint; write {both}", node)
        return fitting[0]

    def kinds(self, name: str) -> list[str]:
        """Return the kinds, ``bodies`` or ``joints`` or both, that contain an element with this name."""
        return [kind for kind in _BARE if name in self.known[kind]]

    def of(self, kind: str, name: str, attribute: str, node: ast.expr) -> Code:
        """Return the program of a quantity of a body, joint or other element of the mechanism."""
        name = self._last.get(name, name) if kind == "bodies" else name
        if name not in self.known[kind]:
            self.unknown(name, self.known[kind], kind_of_word(kind).one, node)
        self.checked(attribute, [kind], name, node)
        if Quantity(kind, name, attribute).beam:
            return self.along(name, attribute, node)
        if attribute in _ANGLES and (kind == "bodies" or self.mechanism.joints[name].travel is None):
            for body in (name,) if kind == "bodies" else self.mechanism.joints[name].bodies:
                if body != GROUND and self.mechanism.bodies[body].inertia is None:
                    self.refuse(f"'{body}' is a point mass (it has no inertia), so it has no angle", node)
        return self.get(Quantity(kind, name, attribute))

    def of_controller(self, name: str, value: str, node: ast.expr) -> Code:
        """Return the program of an output or a state of a controller."""
        controllers = self.mechanism.controllers
        if name not in controllers:
            self.unknown(name, [*controllers], "controller", node)
        known = [*controllers[name].outputs, *controllers[name].states]
        if value not in known:
            hint = f"{did_you_mean(value, known)}; it has {listed(known, 'and')}"
            self.refuse(f"controller '{name}' has no '{value}'{hint}", node)
        return self.get(Quantity("states", f"{name}.{value}", "value"))

    def of_element(self, name: str, attribute: str, index: ast.expr, node: ast.expr) -> Code:
        """Return the program of a quantity of one element of a beam."""
        if name not in self.known["beams"]:
            self.unknown(name, self.known["beams"], kind_of_word("beams").one, node)
        self.checked(attribute, ["beams"], name, node)
        if not Quantity("beams", name, attribute).beam:
            self.refuse(
                f"'{attribute}' is a quantity of the whole beam; write it without the number of an element", node
            )
        count = self.mechanism.beams[name].elements
        match index:
            case ast.Constant(value=int() as element) if not isinstance(element, bool) and element < count:
                pass
            case ast.UnaryOp(ast.USub(), ast.Constant(value=int() as back)) if 0 < back <= count:
                element = count - back
            case _:
                self.refuse(
                    f"'{self.segment(index)}' is not an element of the beam '{name}', which has the elements 0 to "
                    f"{count - 1} (-1 is the last)",
                    node,
                )
        return self.get(Quantity("beams", name, attribute, element))

    def along(self, name: str, attribute: str, node: ast.expr) -> Code:
        """Raise SpecError for a quantity in all elements of a beam, which is not allowed in events."""
        self.refuse(
            f"'{attribute}' has one value for each element of the beam '{name}'; choose an element, from 0: "
            f"{self.segment(node)}[0]",
            node,
        )

    def get(self, quantity: Quantity) -> Code:
        """Return the program that pushes a quantity, which is known to exist."""
        if quantity not in self.quantities:
            self.quantities.append(quantity)
        return [("get", float(self.quantities.index(quantity)))]

    def checked(self, attribute: str, kinds: Sequence[str], name: str, node: ast.expr) -> str:
        """Return `attribute` if it is a quantity of one of the kinds; raise SpecError otherwise."""
        if not (known := [word for kind in kinds for word in self.attributes.get(kind, ())]):
            self.refuse(f"'{self.segment(node)}' cannot be part of an expression of the state", node)
        if attribute not in known:
            whose = " and ".join(f"{kind_of_word(kind).one} '{name}'" for kind in kinds) if name else "energy"
            hint = f"{did_you_mean(attribute, known)}; it has {listed(known, 'and')}"
            self.refuse(f"{whose} has no '{attribute}'{hint}", node)
        return attribute

    def unknown(self, name: str, known: Sequence[str], what: str, node: ast.expr) -> NoReturn:
        """Raise SpecError for an unknown name."""
        few = f"; there are {listed(known[:6])}{', ...' * (len(known) > 6)}" if known else "; there are none"
        hint = did_you_mean(name, known) or few
        for meant in (word for word in known if not word.isidentifier() and f"'{word}'" in hint):
            kind = next((kind for kind, names in self.known.items() if meant in names), "")
            hint = f" (did you mean {kind}[{meant!r}]?)" if kind else hint
        self.refuse(
            f"there is no {what} '{name}'{', because the ground does not move' if name == GROUND else hint}", node
        )
