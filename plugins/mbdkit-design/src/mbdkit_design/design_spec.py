"""The spec of a design: variables of a base spec, goals to minimise, limits, and the optimiser."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    ModelWrapValidatorHandler,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
    model_validator,
)

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import copied, path_text, value_text
from mbdkit.base.strict_model import FormatVersion
from mbdkit.base.text import counted, listed
from mbdkit.base.units import Unit, read_quantity, read_unit
from mbdkit.mechanism.checks import check_name
from mbdkit.mechanism.values import Number, Positive, pair
from mbdkit.spec.model_spec import StrictSpec
from mbdkit.spec.reading import parse_key, variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.sections import Count, Section
from mbdkit.spec.study_measures import DefinedMeasure, defined
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec
from mbdkit_studies import Overrides

GOAL = "goal"  #: Name of the only goal if `minimize` is an expression.
#: Largest violation of a limit that counts as zero, relative to the largest magnitude of the limits of the measure and
#: its value at the start.
FEASIBLE = 1e-6


class _WithUnit(Section):
    """Base class of sections whose numbers may have units, which must fit each other.

    Whether a unit fits the key that a number sets is checked by the spec of the run.
    """

    _units: dict[str, Unit] = PrivateAttr(default_factory=dict)

    @model_validator(mode="wrap")
    @classmethod
    def _without_unit(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(data, Mapping):
            return handler(data)
        values, units = copied(data), {}  # type: dict[str, Any], dict[str, Unit]
        for key, value in values.items():
            numbers = value if isinstance(value, list) else [value]
            for index, number in enumerate(numbers if key in cls.NUMBERS else ()):
                with SpecError.locate(key):
                    quantity = read_quantity(number)
                if quantity is None:
                    continue
                numbers[index] = quantity[0]
                unit = units.setdefault(key if key in cls.APART else "", quantity[1])
                if not (quantity[1].fits(unit) or unit.fits(quantity[1])):
                    raise SpecError(f"has the unit {quantity[1]}, which does not fit the unit {unit}", key=key)
            values[key] = numbers if isinstance(value, list) else numbers[0]
        section = handler(values)
        section._units = units
        return section

    @model_serializer(mode="wrap")
    def _with_unit(self, serialize: SerializerFunctionWrapHandler) -> Any:
        """Write numbers with their SI unit, so that a spec that is read again writes the same values into its bases."""
        data = serialize(self)
        for key in self.NUMBERS:
            match data.get(key):
                case list() | tuple() as numbers:
                    data[key] = [self._text(number, key) for number in numbers]
                case float() as number:
                    data[key] = self._text(number, key)
        return data

    def _text(self, number: float, key: str = "") -> float | str:
        """Return a number with its SI unit, if it has one."""
        unit = self._units.get(key if key in self.APART else "")
        return number if unit is None else f"{number!r} {unit.si}"

    NUMBERS: ClassVar[tuple[str, ...]]
    """Keys that may have a unit."""
    APART: ClassVar[tuple[str, ...]] = ()
    """Those among them whose unit is not that of the others."""


class Variable(_WithUnit):
    """A number of the base spec that the optimiser chooses."""

    NUMBERS: ClassVar[tuple[str, ...]] = ("bounds", "start")

    bounds: Pair
    """Smallest and largest value."""
    start: Number | None = None
    """Value at which the search begins, and with which the optimum is compared; by default, the middle of the
    bounds."""

    @model_validator(mode="after")
    def _start_in_bounds(self) -> Variable:
        low, high = self.bounds
        if low >= high:
            hint = "; to fix it, set its key under `overrides`" if low == high else ""
            raise SpecError(f"the lower bound {low:g} should be less than the upper bound {high:g}{hint}", key="bounds")
        if self.start is not None and not low <= self.start <= high:
            raise SpecError(f"should be within the bounds {low:g} and {high:g}, not {self.start:g}", key="start")
        return self

    def take_unit(self, unit: str) -> None:
        """Use the unit of the parameter in the base, in SI, unless the variable has a unit of its own."""
        if unit and not self._units:
            self._units[""] = read_unit(unit)

    @property
    def first(self) -> float:
        """Value at which the search begins."""
        return 0.5 * (self.bounds[0] + self.bounds[1]) if self.start is None else self.start

    @property
    def width(self) -> float:
        """Distance between the bounds."""
        return float(self.bounds[1] - self.bounds[0])

    @property
    def written(self) -> float | str:
        """The first value, with its SI unit if the variable has one."""
        return self._text(self.first)


Pair = Annotated[tuple[Number, Number], BeforeValidator(pair("two numbers [lower, upper]"))]


class TableVariable(_WithUnit):
    """The values of a table of the base, of a law `table` or of the profile of a cam, at equal distances.

    The arguments of the table reach from the first to the last one in the base. Units are SI unless they are given.
    """

    NUMBERS: ClassVar[tuple[str, ...]] = ("bounds", "start", "slope", "curvature")
    APART: ClassVar[tuple[str, ...]] = ("slope", "curvature")
    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("start", "slope", "curvature")

    points: Annotated[int, Field(ge=4, le=1000)]
    """Number of values."""
    bounds: Pair
    """Smallest and largest value."""
    start: Number | Annotated[list[Number], Field(min_length=2)] | None = None
    """Values at which the search begins, and with which the optimum is compared: one for all points, or several at
    equal distances, between which lines are drawn; two make one straight line. By default, the table of the base."""
    slope: Pair | None = None
    """Smallest and largest slope of the lines between neighbouring values."""
    curvature: Pair | None = None
    """Smallest and largest curvature: difference of the slopes on both sides of a value, divided by the distance."""

    @model_validator(mode="after")
    def _ordered(self) -> TableVariable:
        for key in ("bounds", "slope", "curvature"):
            low, high = getattr(self, key) or (0.0, 1.0)
            if low >= high:
                raise SpecError(f"the lower limit {low:g} should be less than the upper limit {high:g}", key=key)
        low, high = self.bounds
        for value in np.ravel([] if self.start is None else self.start):
            if not low <= value <= high:
                raise SpecError(f"should be within the bounds {low:g} and {high:g}, not {value:g}", key="start")
        return self

    def check_units(self, of_values: str, of_arguments: str) -> None:
        """Raise SpecError if a unit does not fit those of the values and arguments of the table."""
        wanted = {"": of_values, "slope": f"{of_values}/{of_arguments}", "curvature": f"{of_values}/{of_arguments}^2"}
        for key, unit in self._units.items():
            if not unit.fits(read_unit(wanted[key])):
                raise SpecError(f"has the unit {unit}, which does not fit {wanted[key]}", key=key or "bounds")


def _kind_of_variable(value: object) -> str:
    is_table = "points" in value if isinstance(value, Mapping) else isinstance(value, TableVariable)
    return "table" if is_table else "number"


class Limit(_WithUnit):
    """A measure that the design keeps within limits, in every scenario."""

    NUMBERS: ClassVar[tuple[str, ...]] = ("max", "min")

    value: str
    """Expression of a run, as in `measures`."""
    max: Number | None = None
    """Largest value."""
    min: Number | None = None
    """Smallest value."""

    @model_validator(mode="after")
    def _has_a_limit(self) -> Limit:
        if self.max is None and self.min is None:
            raise SpecError("is missing: give `max`, `min` or both", key="max")
        if self.max is not None and self.min is not None and self.min > self.max:
            raise SpecError(f"should be at most `max`, {self.max:g}, not {self.min:g}", key="min")
        return self

    @property
    def ends(self) -> tuple[float, float]:
        """Smallest and largest value; infinite without a limit."""
        return -math.inf if self.min is None else self.min, math.inf if self.max is None else self.max

    def holds(self, values: np.ndarray) -> bool:
        """Return whether values of the measure satisfy the limits, except for rounding errors; nan does not."""
        slack = FEASIBLE * max(abs(end) for end in self.ends if math.isfinite(end))
        low, high = self.ends
        return bool(np.all((values >= low - slack) & (values <= high + slack)))

    @property
    def measure(self) -> dict[str, str]:
        """The expression, with the SI unit of the limits if they have one."""
        return {"value": self.value} | ({} if not self._units else {"unit": self._units[""].si})


@dataclass(frozen=True, eq=False)
class ChosenTable:
    """A table that the optimiser chooses.

    - `keys`: for each of the N values, the dotted key of the number that sets it.
    - `at`: (N,) arguments.
    - `start`: (N,) values at which the search begins.
    - `units`: units of arguments and values.
    """

    variable: TableVariable
    keys: tuple[str, ...]
    at: np.ndarray
    start: np.ndarray
    units: tuple[str, str]

    @cached_property
    def numbers(self) -> dict[str, Variable]:
        """The values as variables."""
        bounds = self.variable.bounds
        return {key: Variable(bounds=bounds, start=x) for key, x in zip(self.keys, self.start.tolist(), strict=True)}

    def values(self, variables: Mapping[str, float]) -> np.ndarray:
        """Return the values (N,) among those of all variables."""
        return np.array([variables[key] for key in self.keys])

    @property
    def is_closed(self) -> bool:
        """Whether the table is periodic, so that both ends are one number."""
        return self.keys[0] == self.keys[-1]

    @property
    def rows(self) -> Iterator[tuple[str, np.ndarray, float, float]]:
        """The limits of slope and curvature: name, combinations (L, N) of the values, and their limits."""
        step, difference = self.at[1] - self.at[0], np.eye(len(self.at))
        for name in ("slope", "curvature"):
            difference = np.diff(difference, axis=0) / step
            if limits := getattr(self.variable, name):
                yield name, difference, *limits
            if self.is_closed:
                difference = np.vstack([difference, difference[:1]])

    def violations(self, key: str, variables: Mapping[str, float], share: float) -> Iterator[str]:
        """Yield how many slopes and curvatures exceed their limits by more than a share of these, and by how much."""
        for name, rows, low, high in self.rows:
            found = rows @ self.values(variables)
            over = np.maximum(found - high, low - found)
            if count := int(np.sum(over > share * max(abs(low), abs(high)))):
                yield f"{counted(count, name)} of {key} beyond the limits, by up to {over.max():.4g} in SI units"

    def remark(self, variables: Mapping[str, float]) -> str:
        """Return how many values, slopes and curvatures are at their limits, in words; empty if none is."""
        values, parts = self.values(variables), []
        for name, rows, low, high in (("value", np.eye(len(self.at)), *self.variable.bounds), *self.rows):
            found, slack = rows @ values, 1e-6 * (high - low)
            if count := int(np.sum((np.abs(found - low) <= slack) | (np.abs(found - high) <= slack))):
                parts.append(f"{count} of {counted(len(found), name)}")
        return f"{listed(parts, 'and')} are at their limits" if parts else ""


class Scenario(Section):
    """One of several situations in which a design is used, such as walking and standing up."""

    base: str | dict[str, Any] | None = None
    """The spec of a run or of inverse dynamics for this situation: the name of a packaged example, a file, or a
    mapping; by default, the `base` at the top level of the design."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base."""
    weight: Positive = 1.0
    """Weight of the goals of this scenario in the sum over the scenarios."""


class LocalOptimizer(Section):
    """A method that follows gradients to a local minimum, from one or several starts.

    `bundle` is for goals and limits with kinks, such as maxima over time: it combines the gradients of nearby points.
    """

    name: Literal["slsqp", "trust-constr", "bundle", "least-squares"]
    starts: Count = 1
    """Number of starts: the first at the `start` of the variables, the others in a Sobol sequence within the bounds."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the Sobol sequence."""
    tolerance: Positive = 1e-9
    """Relative change of the goal, and of the variables relative to the distance between their bounds, at which a
    search ends."""
    max_iterations: Count = 100
    """Largest number of iterations of each search."""


class GlobalOptimizer(Section):
    """Differential evolution, which needs no gradients."""

    name: Literal["differential-evolution"]
    population: Count = 15
    """Population size (number of members) for each variable."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random numbers."""
    tolerance: Positive = 1e-6
    """Spread of the population, relative to its mean, at which the search ends."""
    max_iterations: Count = 200
    """Largest number of generations."""


class EvolutionStrategy(Section):
    """CMA-ES, which needs no gradients, for two variables or more; by the package `cma`."""

    name: Literal["cma-es"]
    population: Annotated[int, Field(ge=3)] | None = None
    """Population size (number of members of a generation); by default 4 + 3 log(n) for n variables."""
    spread: Annotated[float, Field(gt=0, le=1)] = 0.25
    """Standard deviation of the first generation around the start, as a share of the distance between the bounds."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random numbers."""
    tolerance: Positive = 1e-9
    """Relative change of the goal, and of the variables relative to the distance between their bounds, at which the
    search ends."""
    max_iterations: Count = 500
    """Largest number of generations."""


Optimizer = LocalOptimizer | GlobalOptimizer | EvolutionStrategy


def _check_goals(value: object) -> object:
    if not isinstance(value, str | Mapping):
        raise SpecError(f"should be an expression, or a mapping of names and expressions, not {value_text(value)}")
    if value == {}:
        raise SpecError("needs at least one goal, such as `torque: rms(joints.motor.torque)`")
    return value


def _check_comparison(settings: dict[str, object]) -> dict[str, object]:
    if not settings:
        raise SpecError("needs dotted keys of the base and their values, such as {time.step: 0.1}")
    return settings


def _check_variables(variables: dict[str, Variable | TableVariable]) -> dict[str, Variable | TableVariable]:
    if not variables:
        raise SpecError("needs at least one variable, such as `stiffness: {bounds: [0, 100]}`")
    for name in variables:
        if not parse_key(name):
            message = "should be the name of a parameter, or a dotted key of the base spec"
            raise SpecError(message, key=path_text((name,)))
    return variables


MOST_SCENARIOS = 1000  #: Maximum number of scenarios; the spec of each is validated before the first run.


def _check_scenarios(scenarios: dict[str, Scenario]) -> dict[str, Scenario]:
    if len(scenarios) > MOST_SCENARIOS:
        raise SpecError(f"has {len(scenarios)} scenarios; a design has at most {MOST_SCENARIOS}")
    known: dict[str, str] = {}
    for name in map(str, scenarios):
        if known.setdefault(name.casefold(), name) != name:
            other = known[name.casefold()]
            raise SpecError(f"'{other}' and '{name}' differ in case only, so that their archives may be the same file")
    return scenarios


class DesignSpec(StrictSpec):
    """The complete input of a design: a base spec, the numbers to choose, what to minimise and what to keep.

    Raises
    ------
    SpecError
        If the spec is not valid, with the key path.
    """

    model_config = ConfigDict(title="mbdkit design spec", defer_build=True)

    mbdkit_design: FormatVersion
    """Version of the spec format."""
    title: str = ""
    """Title, free text."""
    base: str | dict[str, Any] | None = None
    """The spec of a run or of inverse dynamics: the name of a packaged example, a file, or a mapping."""
    overrides: Overrides = Field(default_factory=dict)
    """Dotted keys to set in the base of every scenario, such as `time.end: 5.0`."""
    scenarios: Annotated[dict[str, Scenario], AfterValidator(_check_scenarios)] = Field(default_factory=dict)
    """Situations by name. Goals and limits are evaluated in each of them. By default, the base is the only situation.
    """
    variables: Annotated[
        dict[
            str,
            Annotated[
                Annotated[Variable, Tag("number")] | Annotated[TableVariable, Tag("table")],
                Discriminator(_kind_of_variable),
            ],
        ],
        AfterValidator(_check_variables),
    ]
    """The numbers to choose, by the name of a parameter or a dotted key, such as `model.forces.spring.stiffness`, and
    tables, such as `model.forces.spring.table`, by the number of their `points`."""
    minimize: Annotated[str | dict[str, str], BeforeValidator(_check_goals)]
    """What to minimise: an expression of a run, as in `measures`, or several by name, which give a Pareto front."""
    subject_to: dict[str, Limit] = Field(default_factory=dict)
    """Measures that are kept within limits, by name."""
    optimizer: Annotated[Optimizer, Field(discriminator="name")] = LocalOptimizer(name="slsqp")
    """The method: `slsqp`, `trust-constr`, `least-squares` or `differential-evolution` of SciPy, `cma-es` or `bundle`,
    and its options; `least-squares` minimises the sum of the squares of all expressions of `minimize`."""
    front: Annotated[int, Field(ge=3, le=1000)] = 9
    """Number of points of a Pareto front of two goals, both ends included. With three goals: number of limits for the
    second goal, and for the third; the first goal is minimised for all combinations of these limits."""
    compare: dict[str, Annotated[Overrides, AfterValidator(_check_comparison)]] = Field(default_factory=dict)
    """Other settings of the runs, each under a name of your choice, with which the optimisation is repeated, such as
    another integrator or step: `{coarse: {time.step: 0.1}}`. The best point for each of these settings is then
    evaluated with the settings of the design."""

    _specs: dict[str, RunSpec | InverseSpec] = PrivateAttr(default_factory=dict)
    _tables: dict[str, ChosenTable] = PrivateAttr(default_factory=dict)
    _compared_specs: dict[str, dict[str, RunSpec | InverseSpec]] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> DesignSpec:
        if self.base is None and not self.scenarios:
            raise SpecError("is missing: the spec to improve (a packaged example, a file or a mapping)", key="base")
        for name, scenario in self.scenarios.items():
            check_name(name, path_text(("scenarios", name)))
            if self.base is None and scenario.base is None:
                message = "is missing: give the spec to improve, here or at the top level of the design"
                raise SpecError(message, key=path_text(("scenarios", name, "base")))
        tables = [one for one in self.variables.values() if isinstance(one, TableVariable)]
        if self.sums_squares and (self.subject_to or any(one.slope or one.curvature for one in tables)):
            message = "does not support limits (`subject_to`, `slope`, `curvature`); use slsqp, bundle or trust-constr"
            raise SpecError(message, key="optimizer.name")
        if len(self.totals) > 3:
            raise SpecError(
                f"has {len(self.goals)} goals; a Pareto front has two or three. Combine some of them in one expression",
                key="minimize",
            )
        if self.optimizer.name == "cma-es" and len(self.variables) == 1 and not tables:
            message = "needs two variables or more; use slsqp or differential-evolution for one"
            raise SpecError(message, key="optimizer.name")
        self._check_comparisons()
        for name in self.subject_to:
            if name in self.goals:
                raise SpecError("is the name of a goal too; choose another one", key=path_text(("subject_to", name)))
        tuple(self.defined_measures())
        return self

    def _check_comparisons(self) -> None:
        if self.compare and len(self.totals) > 1:
            raise SpecError("is not available for Pareto fronts, only for a single goal; omit it", key="compare")
        for name, settings in self.compare.items():
            if not name.strip() or not name.isprintable():
                raise SpecError(f"needs printable text as the name of settings, not {name!r}", key="compare")
            for key in settings:
                if parse_key(key) in map(variable_path, self.variables):
                    where = path_text(("compare", name, key))
                    raise SpecError("is a variable of the design, which the optimizer chooses", key=where)

    @property
    def single(self) -> dict[str, Variable]:
        """The variables that are numbers."""
        return {name: one for name, one in self.variables.items() if isinstance(one, Variable)}

    @property
    def tables(self) -> Mapping[str, ChosenTable]:
        """The variables that are tables, with their arguments."""
        return self._tables

    @property
    def chosen(self) -> dict[str, Variable]:
        """All numbers that the optimiser chooses, by name or key: the single variables, and the values of tables."""
        found: dict[str, Variable] = {}
        for name, one in self.variables.items():
            found |= {name: one} if isinstance(one, Variable) else self.tables[name].numbers
        return found

    @property
    def goals(self) -> dict[str, str]:
        """Expressions of the goals by name."""
        return {GOAL: self.minimize} if isinstance(self.minimize, str) else dict(self.minimize)

    @property
    def sums_squares(self) -> bool:
        """Whether the sum of the squares of all goals is minimised, instead of the goals themselves."""
        return self.optimizer.name == "least-squares"

    @property
    def totals(self) -> tuple[str, ...]:
        """Names of the functions that are minimised: the goals, or their sum of squares."""
        return (GOAL,) if self.sums_squares else tuple(self.goals)

    @property
    def situations(self) -> dict[str, Scenario]:
        """The scenarios by name; without scenarios, the base is the only one, and has an empty name."""
        return self.scenarios or {"": Scenario()}

    @property
    def specs(self) -> Mapping[str, RunSpec | InverseSpec]:
        """The validated specs of the scenarios by name, with the variables at their start values."""
        return self._specs

    @property
    def compared_specs(self) -> Mapping[str, Mapping[str, RunSpec | InverseSpec]]:
        """The validated specs of the scenarios for each set of settings in `compare`, by the name of the set."""
        return self._compared_specs

    def defined_measures(self) -> Iterator[DefinedMeasure]:
        """Yield goals and limits as measures, with their locations in this spec."""
        for measure in defined(self.goals, ("minimize",)):
            yield measure if isinstance(self.minimize, Mapping) else replace(measure, place=("minimize",))
        for name, limit in self.subject_to.items():
            yield from defined({name: limit.measure}, ("subject_to",))
