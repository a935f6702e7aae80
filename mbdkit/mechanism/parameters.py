"""Named parameters of a model, and expressions of them that stand for its numbers.

An expression consists of numbers, names of parameters, ``pi``, ``+ - * / **``, parentheses and the functions of
motions; ``degrees(45)`` is an angle in radians. A number with a unit, ``2 N/mm``, is replaced by its value in SI units
if the unit agrees with the one in the description of the key. Validation shows where a model requires a number: there,
it rejects the text of an expression. It is then repeated with the value of the expression. In functions of time, of the
state, of an angle and of coordinates, the names of parameters are replaced by their values.
"""

from __future__ import annotations

import ast
import graphlib
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, parse_path, path_text, value_text
from mbdkit.base.strict_model import StrictModel, description
from mbdkit.base.text import did_you_mean, listed
from mbdkit.base.traced_numbers import as_float, text_with
from mbdkit.base.units import PLAIN, Unit, described_units, misfit, read_quantity, read_unit
from mbdkit.expressions.operations import FUNCTIONS
from mbdkit.expressions.parser import Code, Compiler, ExpressionError
from mbdkit.mechanism.angle_function import AngleCompiler, AngleExpressionError
from mbdkit.mechanism.bodies import Element
from mbdkit.mechanism.coordinate_function import CoordinateCompiler, CoordinateExpressionError
from mbdkit.mechanism.law_element import PluginLookup
from mbdkit.mechanism.parameter_units import unit_of_expression
from mbdkit.mechanism.state_values import StateExpressionError, StateSyntax
from mbdkit.mechanism.validation_errors import spec_error, value_path, walk
from mbdkit.mechanism.values import TextForNumberError

Validated = TypeVar("Validated")
Values = Mapping[str, float]


class ParameterValues(dict[str, float]):
    """Values of named parameters in SI units; the attribute `units` has the units of parameters that have one."""

    def __init__(self, values: Mapping[str, float] = {}, units: Mapping[str, Unit] = {}) -> None:
        super().__init__(values)
        self.units = dict(units)


Written = dict[Path, "WrittenText"]  #: Expressions by key path.
#: Kind of a value; functions of variables have the names of these.
Kind = (
    tuple[str, ...]
    | Literal[
        "quantity", "number", "whole number", "function of time", "function of the state", "function of an angle",
        "function of coordinates",
    ]
)  # fmt: skip


class WrittenText(str):
    """An expression as the user wrote it; the attribute `kind` has the kind of value for which it stands."""

    __slots__ = ("kind",)
    kind: Kind

    @classmethod
    def of(cls, text: str, kind: Kind) -> WrittenText:
        """Return a text with the kind of its value."""
        result = cls(text)
        result.kind = kind
        return result

    def value(self, values: Values, path: Path) -> float | int | str:
        """Return the value for other values of the parameters; see `with_expressions`."""
        return _value(self, self.kind, values, path)


_COMPILERS: Mapping[Kind, type[Compiler]] = {
    "function of time": Compiler,
    "function of the state": StateSyntax,
    "function of an angle": AngleCompiler,
    "function of coordinates": CoordinateCompiler,
}
_KINDS: tuple[tuple[type[ExpressionError], Kind], ...] = (
    (AngleExpressionError, "function of an angle"),
    (StateExpressionError, "function of the state"),
    (ExpressionError, "function of time"),
)

RESERVED = frozenset({"t", "pi", *FUNCTIONS})

FROM = "from"  #: Reserved key among named parameters: the file from which further parameters are taken.

_NUMBER = re.compile(r"\s*[-+]?(\d+(\.\d*)?|\.\d+)(,\d+)?([eE][-+]?\d+)?\s*")
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
#: A name that is not part of a quantity such as ``bodies.leg.angle``. Quoted names match, too, but are not changed.
_NAME_ALONE = re.compile(r"\"[^\"]*\"|'[^']*'|(?<![\w.])[A-Za-z_]\w*(?![\w]|\s*[.\[])")


def parameter_values(given: object) -> ParameterValues:
    """Return the values of named parameters.

    `given`: numbers, and expressions of other parameters in any order, by name. Raises SpecError if a name is wrong, an
    expression is not valid or not finite, or a parameter depends on itself. The error has the key path
    ``parameters.NAME``.
    """
    if given is None:
        return ParameterValues()
    if not isinstance(given, Mapping):
        raise SpecError(f"should be a mapping of names and numbers, not {value_text(given)}", key="parameters")
    units = {name: quantity[1] for name, quantity in _quantities(given).items()}
    given = without_units(given)
    for name, value in given.items():
        _check(name, value)
    values: dict[str, float] = {}
    for name in _in_order_of_use({name: names_in(value) & given.keys() for name, value in given.items()}):
        value = given[name]
        with SpecError.locate(f"parameters.{name}"):
            values[name] = evaluate(value, values, [*given]) if isinstance(value, str) else as_float(value)
            unit = unit_of_expression(value, units) if units and isinstance(value, str) else None
        if unit is not None:
            units[name] = unit
    return ParameterValues({name: values[name] for name in given}, units)


def without_units(parameters: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return named parameters in which numbers with a unit are replaced by numbers in SI units.

    Raises SpecError if a unit is not known. The error has the key path.
    """
    return dict(parameters) | {name: quantity[0] for name, quantity in _quantities(parameters).items()}


def _quantities(parameters: Mapping[Any, Any]) -> dict[Any, tuple[float, Unit]]:
    """Return value and unit of the parameters that are numbers with a unit."""
    quantities = {}
    for name, value in parameters.items():
        with SpecError.locate(f"parameters.{name}"):
            quantity = read_quantity(value, {"pi", *parameters})
        if quantity is not None:
            quantities[name] = quantity
    return quantities


def evaluate(text: str, values: Values, known: list[str] | None = None) -> float:
    """Return the value of an expression of parameters.

    `known`: names that an error message may suggest in place of a misspelled one; by default those in `values`. Raises
    SpecError for the first error; it contains the position in the text.
    """
    (_, value), *_ = _NumberCompiler(text, values, known).program()
    return value


def names_in(value: object) -> set[str]:
    """Return the names in an expression, or in all texts of a mapping or list; none in other values."""
    if isinstance(value, str):
        return set(_NAME.findall(value))
    values = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    return set().union(*map(names_in, values))


def parameters_in_use(parameters: Mapping[str, object], texts: Iterable[object]) -> set[str]:
    """Return the names of the parameters that expressions use, directly or through other parameters."""
    used: set[str] = set()
    fresh: set[str] = set().union(*map(names_in, texts)) & parameters.keys()
    while fresh:
        used |= fresh
        fresh = set().union(*(names_in(parameters[name]) for name in fresh)) & parameters.keys() - used
    return used


def with_expressions(
    validate: Callable[[object], Validated],
    data: object,
    root: object,
    values: Values,
    *,
    section: Path = (),
    prefix: str = "",
    plugins: PluginLookup | None = None,
) -> tuple[Validated, Written]:
    """Validate plain data whose numbers may be expressions of parameters.

    - `validate`: function that validates the data and returns the result.
    - `data`: the data; expressions are replaced by their values in place.
    - `root`: the model that is validated.
    - `values`: values of the parameters by name.
    - `section`: key path of the part that may contain expressions; numbers with units may be anywhere.
    - `prefix`: key path of the data in a spec; empty if the data are a whole spec.
    - `plugins`: lookup of the models that plugins add; by default, of the installed plugins.

    Returns the result of `validate`, and the expressions that were replaced, by key path; numbers with units are not
    included. Raises SpecError for the first error; it contains the key path.
    """
    lookup: PluginLookup = plugins or higher_layers.installed_plugins()
    written: Written = {}
    quantities: Written = {}
    while True:
        try:
            return validate(data), written
        except ValidationError as error:
            fresh = {
                path: (text, kind)
                for path, text, kind in _Texts(data, root, lookup, values).replacements(error)
                if path not in written | quantities and (kind == "quantity" or path[: len(section)] == section)
            }
            if not fresh:
                replaced = written | quantities
                raise spec_error(
                    error, root, prefix=prefix, plugins=lookup, written=replaced, parameters=values
                ) from None
            for path, (text, kind) in fresh.items():
                where = (*parse_path(prefix), *path)
                holder = _at(data, path[:-1])
                (quantities if kind == "quantity" else written)[path] = WrittenText.of(str(holder[path[-1]]), kind)
                holder[path[-1]] = _value(text, kind, values, where) if isinstance(text, str) else text


def in_terms_of(text: str, texts: Mapping[str, str], parameters: Mapping[str, object], values: Values) -> str:
    """Return an expression of parameters with texts in place of some of them, also where others contain these.

    `texts`: the texts by name. `parameters`, `values`: all parameters as they were given, and their values.
    """

    def replaced(name: str) -> str:
        if name in texts:
            return texts[name]
        inside = in_terms_of(given := str(parameters[name]), texts, parameters, values)
        return f"({values[name]!r})" if inside == given else f"({inside})"

    used = parameters_in_use(parameters, [text])
    names = {name: replaced(name) for name in used} if used & texts.keys() else {}
    return _NAME_ALONE.sub(lambda match: names.get(match[0], match[0]), text)


def insert(data: object, written: Written) -> Any:
    """Replace values in plain data by the expressions at the same key paths, and return the data.

    Key paths that do not exist in the data are ignored.
    """
    for path, text in written.items():
        try:
            holder = _at(data, path[:-1])
            holder[path[-1]]
        except (LookupError, TypeError):  # a model may store its options in another form
            continue
        holder[path[-1]] = str(text)
    return data


class _NumberCompiler(Compiler):
    """Compiles an expression of parameters, which is a constant."""

    wanted = "an expression of the parameters, which consists of numbers, their names, pi"

    def __init__(self, text: str, parameters: Values, known: list[str] | None = None):
        self.known = [*parameters] if known is None else known
        super().__init__(text, parameters)

    def compile(self, node: ast.expr, nesting: int) -> Code:
        """Return the program of a node, in which time is not an operand."""
        if isinstance(node, ast.Name) and node.id == "t":
            self.refuse("this number cannot depend on the time t; only motions and loads can", node)
        return super().compile(node, nesting)

    def operand(self, node: ast.expr) -> Code:
        """Raise SpecError for a name that is not a parameter, or for anything else."""
        if isinstance(node, ast.Name):
            hint = did_you_mean(node.id, ["pi", *FUNCTIONS, *self.known])
            text = f"; parameters: {listed(self.known)}" if self.known else "; the spec has no `parameters`"
            alone = f"should be a number, not the text '{node.id}': " if node.id == self.source else ""
            self.refuse(f"{alone}there is no parameter '{node.id}'{hint or text}", node)
        return super().operand(node)


def _check(name: object, value: object) -> None:
    """Raise SpecError unless `name` can be used in expressions, and `value` is a number or text."""
    key = f"parameters.{name}"
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
        raise SpecError("a parameter has a name of letters, digits and underscores, such as crank_length", key=key)
    if name == FROM:
        message = (
            "names the file of an identification, which is read when a spec or a base is loaded; it cannot be set here"
        )
        raise SpecError(message, key=key)
    if name in RESERVED:
        raise SpecError(f"'{name}' has a meaning in expressions already; choose another name", key=key)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise SpecError(f"should be a number, or an expression of other parameters, not {value_text(value)}", key=key)
    if not isinstance(value, str) and not abs(value) <= sys.float_info.max:
        raise SpecError(f"should be a finite number, not {value!r}", key=key)


def _in_order_of_use(uses: Mapping[str, set[str]]) -> Iterator[str]:
    """Return the names in an order in which each follows the names that it uses; raise SpecError for a cycle."""
    sorter = graphlib.TopologicalSorter({name: sorted(used) for name, used in uses.items()})
    try:
        sorter.prepare()
    except graphlib.CycleError as error:
        cycle: list[str] = error.args[1][::-1]  # each name uses the next one
        message = f"depends on itself: {' -> '.join(cycle)}"
        raise SpecError(message, key=f"parameters.{cycle[0]}") from None
    while sorter.is_active():
        ready = sorter.get_ready()
        yield from ready
        sorter.done(*ready)


class _Texts:
    """Texts in place of numbers in data that do not validate: what replaces them, and which unit they must have."""

    def __init__(self, data: object, root: object, plugins: PluginLookup, values: Values):
        self.data, self.root, self.plugins, self.values = data, root, plugins, values
        self.units = values.units if isinstance(values, ParameterValues) else {}

    def replacements(self, error: ValidationError) -> Iterator[tuple[Path, str | float, Kind]]:
        """Yield the key path of each rejected text, its replacement, and the expected kind of value.

        The replacement of a number with a unit is its value in SI units. The replacement of an expression is its text,
        which the caller evaluates.
        """
        known = {"t", "pi", *self.values}
        for details in error.errors(include_url=False):
            inner = details.get("ctx", {}).get("error")
            if not (
                isinstance(inner, TextForNumberError | ExpressionError) or details["type"] in ("float_type", "int_type")
            ):
                continue  # checked before the path is searched, which would be slow for many thousands of errors
            path, _ = walk(details["loc"], self.root, self.plugins)
            if isinstance(inner, TextForNumberError):  # raised only for the first text in a list of numbers
                path = value_path(path, parse_path(inner.key))
                if read_quantity(text := _at(self.data, path), known):
                    message = f"should be a number without a unit, since tables are in SI units, not '{text}'"
                    raise SpecError(message, key=path_text(path))
                for i, text in enumerate(_at(self.data, path[:-1])):
                    if _is_expression(text, self.values):
                        self._check_unit(text, (*details["loc"], i), (*path[:-1], i))
                        yield (*path[:-1], i), text, "number"
                continue
            # raised for the whole model, because only the model knows its coordinates
            if isinstance(inner, CoordinateExpressionError):
                path = value_path(path, parse_path(inner.key))
                text = _at(self.data, path)  # a number with a unit is rejected earlier, because it is not an expression
                if names_in(text) & self.values.keys():
                    yield path, text, "function of coordinates"
                continue
            text = details["input"]
            if _at(self.data, path) != text:
                continue  # the location of a number within a union is not known
            try:
                if quantity := read_quantity(text, known):
                    yield path, self._in_si(*quantity, details), "quantity"
                    continue
            except SpecError as error_of_unit:
                raise error_of_unit.located(prefix=path_text(path)) from None
            if isinstance(inner, ExpressionError) and isinstance(text, str) and self.values:
                kind = _kind_of(inner)
                if kind == "function of time":
                    self._check_unit(text, details["loc"], path, of_time=True)
                yield path, text, kind
            elif details["type"] == "float_type" and (
                _is_expression(text, self.values) or (path[-1] == details["loc"][-1] and _is_name(text))
            ):  # in unions, such a text may be meant as another alternative
                self._check_unit(text, details["loc"], path)
                yield path, text, "number"
            elif details["type"] == "int_type" and _is_expression(text, self.values):
                yield path, text, "whole number"

    def _in_si(self, value: float, unit: Unit, details: ErrorDetails) -> float:
        """Return the value of a number with a unit; raise SpecError if the unit is not that of the key."""
        if details["type"] == "int_type":
            raise SpecError(f"should be a whole number without a unit, not '{details['input']}'")
        if not abs(value) <= sys.float_info.max:
            raise SpecError(f"should be a finite number, not '{details['input']}'")
        if (units := self._units_of(details["loc"])) is not None and not _suits(unit.fits, units):
            raise SpecError(misfit(details["input"], unit, units))
        return value

    def _units_of(self, location: Path) -> tuple[str, ...] | None:
        """Return the units of the number at a location, from the description of its key; None if that is unknown."""
        for length in range(len(location), 0, -1):  # numbers in lists and mappings have the unit of their field
            path, owner = walk(location[:length], self.root, self.plugins)
            if owner is not None and (name := _field(owner, path[-1])):
                break
        else:
            return None
        if issubclass(owner, StrictModel) and (chosen := owner.chosen_unit(name, _at(self.data, path[:-1]))):
            return (chosen,)
        units = described_units(description(owner, name))
        parts, _ = walk(location, self.root, self.plugins)
        if len(units) == 2 and issubclass(owner, Element):
            along = owner.unit_along(_at(self.data, path[:-1]))
            units = units[along == "rad" :][:1] if along else units
        elif len(units) > 2 and isinstance(parts[-1], int):
            units = units[parts[-1] :][:1]
        return units

    def _check_unit(self, text: str, location: Path, path: Path, *, of_time: bool = False) -> None:
        """Raise SpecError for an expression whose unit does not suit its key."""
        with SpecError.locate(path_text(path)):
            unit = unit_of_expression(text, self.units, of_time=of_time) if self.units else None
        units = None if unit is None else self._units_of(location)
        if unit is None or units is None:
            return
        alone = text.strip().lstrip("+- ") in self.units  # in products and quotients, angles count as pure numbers
        if not _suits(unit.fits if alone else unit.is_like, units):
            has_factor = re.search(r"(?<![\w.])\d", text)
            hint = "; factors that have a unit should be parameters, such as `m: 2 kg`" if has_factor else ""
            raise SpecError(f"{misfit(text, unit, units)}{hint}", key=path_text(path))


def _kind_of(error: ExpressionError) -> Kind:
    from mbdkit.mechanism.variable_functions import VariableExpressionError  # few models have such texts

    if isinstance(error, VariableExpressionError):
        return error.variables
    return next(kind for error_class, kind in _KINDS if isinstance(error, error_class))


def _suits(fits: Callable[[Unit], bool], units: Sequence[str]) -> bool:
    """Return whether a unit fits one of those that a key takes; without any, it takes pure numbers."""
    return any(fits(read_unit(unit) if unit != "1" else PLAIN) for unit in units or ("1",))


def _field(owner: type[BaseModel], key: str | int) -> str:
    """Return the name of the field that a key sets; empty if there is none."""
    return next((name for name, info in owner.model_fields.items() if key in (name, info.alias)), "")


def _is_expression(text: object, values: Values) -> bool:
    """Return whether a text is intended as an expression.

    It then contains an operator or a parenthesis, or it is the name of one of the `values`, or ``pi``. Quoted numbers
    are not expressions.
    """
    if not isinstance(text, str) or _NUMBER.fullmatch(text):
        return False
    return bool(re.search(r"[-+*/(]", text)) or text.strip() in {"pi", *values}


def _is_name(text: object) -> bool:
    return isinstance(text, str) and text.isidentifier() and text.lower() not in {"inf", "infinity", "nan"}


def _value(text: str, kind: Kind, values: Values, path: Path) -> float | int | str:
    """Return the value of an expression; for a function of time, of the state, of an angle or of coordinates, the text
    with values in place of parameters.
    """
    with SpecError.locate(path_text(path)):
        if isinstance(kind, tuple):
            from mbdkit.mechanism.variable_functions import VariableCompiler

            VariableCompiler(text, kind, values).program()
        elif kind not in _COMPILERS:
            value = evaluate(text, values)
            return int(value) if kind == "whole number" and value.is_integer() else value
        else:
            _COMPILERS[kind](text, values).program()
    own = kind if isinstance(kind, tuple) else (_COMPILERS[kind].variable,)
    known = {name: value for name, value in values.items() if name not in own}
    name = _NAME_ALONE if kind == "function of the state" else _NAME

    def substitute(number_text: Callable[[float], str]) -> str:
        return name.sub(lambda match: f"({number_text(known[match[0]])})" if match[0] in known else match[0], text)

    return text_with(substitute) if kind == "function of the state" and path[:1] == ("model",) else substitute(repr)


def _at(data: Any, path: Path) -> Any:
    for part in path:
        data = data[part]
    return data
