"""Derivatives of the preparation of a run: of the compiled mechanism and of its consistent start, with respect to
parameters.

They follow from the operations that were recorded while the mechanism was built, or from differences where code cannot
be recorded, as that of some plugins.

The preparation validates the model, builds and compiles the mechanism, and assembles its initial state. The numbers in
expressions of measures and events may depend on named parameters, and are differentiated in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Any

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path
from mbdkit.engine.compiled_mechanism import with_ground
from mbdkit.engine.consistent_start import Starts
from mbdkit.mechanism.motion_corners import corners_of
from mbdkit.mechanism.parameters import names_in
from mbdkit.runs.given_start import GivenStart
from mbdkit.runs.preparation import RunSetup
from mbdkit.runs.varied_numbers import VariedNumbers
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_gradients.differentiated_expressions import NO_MEASURES, Definitions, numbers_in, numbers_of
from mbdkit_gradients.gradient_parameters import Parameter, refused
from mbdkit_gradients.parameter_differences import (
    CENTRAL,
    RANK,
    WIDEST,
    Arrays,
    KnownDerivatives,
    Preparation,
    PreparedDerivatives,
    weights,
)
from mbdkit_gradients.recorded_derivatives import StartDerivatives, arrays_from, derivatives_of, inside
from mbdkit_gradients.table_derivatives import ArraysWithTables, TableValues

#: Names of the residuals of the equations of a start with given values.
POSITION, VELOCITY = "position equations", "velocity equations"
#: Largest change of a coordinate [m, rad] by which derivatives of matrices are differences of order 8.
NUDGE = 0.001
RECORDED = ("quantity", "number", "whole number", "function of the state")  #: Kinds of expressions that are recorded.
#: Smallest change of parameters, relative to their sizes, with which it is tested whether arrays are linear.
FURTHER = 0.01


def prepared_derivatives(
    spec: RunSpec, parameters: Sequence[Parameter], definitions: Definitions = NO_MEASURES, starts: Starts | None = None
) -> PreparedDerivatives:
    """Return the derivatives of a prepared run with respect to parameters: of the mechanism, and of its start ``q`` and
    ``v``.

    Parameters
    ----------
    definitions
        The measures, whose numbers may depend on the parameters.
    starts
        Compiled mechanisms; none by default.

    Raises
    ------
    SpecError
        If the structure of the mechanism depends on a parameter, or if the spec is not valid near its value.
    """
    shared = SharedPreparation(starts or Starts())
    return RunPreparation(spec, partial(numbers_of_run, definitions=definitions), shared=shared).derivatives(parameters)


def numbers_of_run(spec: RunSpec, definitions: Definitions) -> Arrays:
    """Return the numbers in the instructions of measures and of events of a spec."""
    return numbers_of(spec, definitions) | numbers_in(spec.watched(), "events")


@dataclass(frozen=True, eq=False)
class SharedPreparation:
    """What preparations of specs with equal models and parameters share, whatever their other sections are.

    Attributes
    ----------
    starts
        Compiled mechanisms.
    specs
        See `VariedSpecs`.
    formulas
        The latest recorded formulas of the arrays by the paths of their parameters, with the values of other paths.
    latest
        The latest formulas with their derivatives; see `RunPreparation._formulas_at`.
    sides
        See `Preparation`.
    """

    starts: Starts = field(default_factory=Starts)
    specs: dict[str, RunSpec] = field(default_factory=dict)
    formulas: dict[object, tuple[object, VariedNumbers]] = field(default_factory=dict)
    latest: dict[object, tuple[Any, np.ndarray, np.ndarray]] = field(default_factory=dict)
    sides: dict[tuple[Path, float], int] = field(default_factory=dict)


class PreparedSpec:
    """A spec with its compiled mechanism, numbers of expressions, and what depends on them alone.

    Parameters
    ----------
    is_given
        Whether quantities have given values at the start.
    """

    def __init__(self, spec: RunSpec, numbers: Callable[[RunSpec], Arrays], starts: Starts, *, is_given: bool):
        self.spec, self._starts = spec, starts
        self.numbers = numbers(spec) if spec.parameters else {}
        self.given = GivenStart(spec.mechanism(), spec, starts) if is_given else None
        self.start = self.given.start if self.given else starts.at_start(spec.mechanism(), *spec.span)
        self.knots = knots_of(spec)

    @cached_property
    def setup(self) -> RunSetup:
        """The setup of the run."""
        return RunSetup.of(self.spec, self._starts)

    def state(self, initial: Mapping[str, float], near: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities at the start (3 (B + 1),), ground last; see `GivenStart.state`."""
        if self.given is None:
            return self.start.q0, self.start.v0
        q, v = self.given.state(initial, None if near is None else near[: self.given.n])
        return with_ground(q), with_ground(v)


@dataclass(frozen=True)
class StartEquations:
    """The equations that determine a start with given values, differentiated as implicit functions.

    Their residuals at a fixed state are mostly linear in the parameters.

    Parameters
    ----------
    given
        Finds states of the mechanism.
    initial
        The given values, by name.
    q, v
        Positions and velocities (n,) that satisfy the equations.
    """

    given: GivenStart
    initial: Mapping[str, float]
    q: np.ndarray
    v: np.ndarray

    @cached_property
    def _matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (R, n) of the residuals with respect to positions, and to velocities."""
        (_, of_positions), (_, of_velocities) = self.given.equations(self.initial, self.q, self.v)
        return of_positions, of_velocities

    @property
    def determine_the_start(self) -> bool:
        """Whether the equations have a single solution, which does not depend on where the search for it begins."""
        light, is_free = self.given.light, len(self.given.search.free) == self.given.n
        moving = np.count_nonzero(light)
        return is_free and all(np.linalg.matrix_rank(x * light, RANK) == moving for x in self._matrices)

    def residuals(self, given: GivenStart, initial: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Return the residuals for another mechanism and other values at the same state, plus a constant of the size of
        their terms, to which rounding errors are relative.
        """
        (position, _), (velocity, _) = given.equations(initial, self.q, self.v)
        length = self.given.length
        return {POSITION: position + length, VELOCITY: velocity + max(length, float(np.max(np.abs(self.v))))}

    def by_numbers(self, points: np.ndarray, numbers: np.ndarray) -> dict[str, np.ndarray]:
        """Return the derivatives (R, K) of the residuals; see `StartDerivatives.by_numbers`.

        The given quantities do not depend on these numbers.
        """
        start = replace(self.given.start, q0=with_ground(self.q), v0=with_ground(self.v))
        derivatives = StartDerivatives(start, self.given.search.t0, np.zeros(self.given.n, dtype=bool))
        slopes = {}
        residuals = (equations[0] for equations in self.given.equations(self.initial, self.q, self.v))
        both = derivatives.by_numbers(points, numbers)
        for name, residual, own in zip((POSITION, VELOCITY), residuals, both, strict=True):
            slopes[name] = np.zeros((len(residual), points.shape[-1]))
            slopes[name][: len(own)] = own
        return slopes

    def by_given(self, names: Sequence[object]) -> dict[str, np.ndarray]:
        """Return the derivatives (R, K) of the residuals with respect to given values by name; 0 for other names."""
        residuals = [residual for residual, _ in self.given.equations(self.initial, self.q, self.v)]
        slopes = {name: np.zeros((len(x), len(names))) for name, x in zip((POSITION, VELOCITY), residuals, strict=True)}
        for column, name in enumerate(names):
            if isinstance(name, str) and name in self.initial:
                moved = self.given.equations({**self.initial, name: self.initial[name] + 1.0}, self.q, self.v)
                for slope, (residual, _), here in zip(slopes.values(), moved, residuals, strict=True):
                    slope[:, column] = np.round(residual - here)  # -1 in the equation of this value
        return slopes

    def completed(self, found: PreparedDerivatives) -> PreparedDerivatives:
        """Return derivatives with those of ``q`` and ``v`` in place of those of the residuals."""
        slopes, count = dict(found.seeds.arrays), len(found.error)
        (rows, _), (rate_rows, _) = self.given.equations(self.initial, self.q, self.v)
        position = slopes.pop(POSITION, np.zeros((len(rows), count)))
        velocity = slopes.pop(VELOCITY, np.zeros((len(rate_rows), count)))
        both = [self._slopes(position[:, k], velocity[:, k]) for k in range(count)]
        slopes |= {name: np.stack([with_ground(one[i]) for one in both], axis=-1) for i, name in enumerate("qv")}
        return replace(found, seeds=replace(found.seeds, arrays=slopes))

    def _slopes(self, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives (n,) of q and v with respect to a parameter, given those of the residuals."""
        light, (of_positions, of_velocities) = self.given.light, self._matrices
        dq = np.zeros(len(self.q))
        if np.any(position):
            dq = -light * np.linalg.lstsq(of_positions * light, position, RANK)[0]
            unit = NUDGE / float(np.max(np.abs(dq)))
            now = self._velocity_residual(0.0 * dq)
            for place, weight in zip(CENTRAL, weights(CENTRAL), strict=True):
                velocity = velocity + weight * (self._velocity_residual(place * unit * dq) - now) / unit
        return dq, -light * np.linalg.lstsq(of_velocities * light, velocity, RANK)[0]

    def _velocity_residual(self, change: np.ndarray) -> np.ndarray:
        return self.given.equations(self.initial, self.q + change, self.v)[1][0]


class RunPreparation(Preparation):
    """Prepares runs of a spec with other values of a parameter.

    Parameters
    ----------
    spec
        The base of the spec.
    numbers
        Function that returns the numbers of expressions that may depend on named parameters, by name of the array.
    initial
        Values of kinematic quantities at the start; see `mbdkit.prepare`. The key path of a parameter that is
        one of them is ``("initial", NAME)``.
    specs, values
        What makes specs from the base, and the values by key path that make the spec; none by default.
    prepared
        Specs that have been prepared, by the values that made them from the base; preparations that differ in nothing
        but `initial` share them.
    equations
        Equations of the start, whose residuals take the place of the start in the arrays.
    shared
        What preparations of bases with equal models and parameters share.
    """

    ROUNDED = ("q", "v", POSITION, VELOCITY)

    def __init__(
        self,
        spec: RunSpec,
        numbers: Callable[[RunSpec], Arrays],
        initial: Mapping[str, float] = MappingProxyType({}),
        specs: VariedSpecs | None = None,
        values: Mapping[Path, float] = MappingProxyType({}),
        prepared: dict[tuple[tuple[Path, float], ...], PreparedSpec] | None = None,
        equations: StartEquations | None = None,
        shared: SharedPreparation | None = None,
    ):
        self.initial, self.values, self._numbers = initial, values, numbers
        self._shared = shared or SharedPreparation()
        self.sides = self._shared.sides
        self._specs = VariedSpecs(spec.canonical_json(), self._shared.specs) if specs is None else specs
        self._prepared, self._equations = {} if prepared is None else prepared, equations
        self._base = spec
        self._own = self._with_values(values)
        self.spec, self.mechanism = self._own.spec, self._own.start.mechanism
        self.base = self._arrays(self._own, initial)

    @property
    def setup(self) -> RunSetup:
        """The setup of a run of the spec from the initial values."""
        own = self._own.setup
        return replace(own, workspace=replace(own.workspace, q0=self.base["q"], v0=self.base["v"]))

    def _with_values(self, values: Mapping[Path, float]) -> PreparedSpec:
        key = tuple(values.items())
        if key not in self._prepared:
            spec = self._specs.spec(key) if key else self._base
            self._prepared[key] = PreparedSpec(spec, self._numbers, self._shared.starts, is_given=bool(self.initial))
        return self._prepared[key]

    def _arrays(
        self, prepared: PreparedSpec, initial: Mapping[str, float], near: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        if self._equations is not None and prepared.given is not None:
            residuals = self._equations.residuals(prepared.given, initial)
            return {**self.mechanism_arrays(prepared.start.mechanism), **residuals, **prepared.numbers}
        q, v = prepared.state(initial, near)
        return {**self.mechanism_arrays(prepared.start.mechanism), "q": q, "v": v, **prepared.numbers}

    def derivatives(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        """See `Preparation.derivatives`.

        They are exact for parameters whose way to the arrays is recorded (`mbdkit.runs.varied_numbers`), and
        differences for all others. If equations determine the start, it is differentiated as an implicit function.
        """
        given = self._own.given
        if given is not None and self._equations is None:
            equations = StartEquations(given, self.initial, self.base["q"][: given.n], self.base["v"][: given.n])
            if equations.determine_the_start:
                known = self._specs, self.values, self._prepared
                other = RunPreparation(self._base, self._numbers, self.initial, *known, equations, self._shared)
                return equations.completed(other.derivatives(parameters))
        if tables := self.tables(parameters):
            return self._with_tables(parameters, tables)
        is_given = np.array([one.path[0] == "initial" for one in parameters])
        if self._equations is not None and np.any(is_given):
            none = np.zeros(len(parameters))
            slopes = self._equations.by_given([one.path[1] if one.path[0] == "initial" else None for one in parameters])
            found = self._completed(slopes, parameters, none, none.astype(int))
            plain = [one for one in parameters if one.path[0] != "initial"]
            return found.with_columns(~is_given, self.derivatives(plain)) if plain else found
        recorded = self._recorded(parameters)
        if recorded is None or not np.any(recorded[1]):
            return self._by_differences(parameters)
        exact, done = recorded
        if np.all(done):
            return exact
        others = self._by_differences([one for one, is_done in zip(parameters, done, strict=True) if not is_done])
        return exact.with_columns(~done, others)

    def _with_tables(self, parameters: Sequence[Parameter], tables: Sequence[TableValues]) -> PreparedDerivatives:
        """Return the derivatives with respect to parameters of which some are values in tables."""
        count, is_other = len(parameters), np.ones(len(parameters), dtype=bool)
        for table in tables:
            is_other[table.columns] = False
        none = np.zeros(count)
        found = self._completed({}, parameters, none, none.astype(int))
        if np.any(is_other):
            others = [one for one, is_one in zip(parameters, is_other, strict=True) if is_one]
            found = found.with_columns(is_other, self.derivatives(others))
        arrays = ArraysWithTables(found.seeds.arrays, tables, len(self.base["law_parameters"]), count)
        return replace(found, seeds=replace(found.seeds, arrays=arrays))

    def _recorded(self, parameters: Sequence[Parameter]) -> tuple[PreparedDerivatives, np.ndarray] | None:
        """Return exact derivatives, and (K,) which of them are known; None if there are none.

        The operations that lead to the arrays are recorded while the mechanism is built once more. A start that
        assembly has changed is left to differences, and so are motions, whose values at the start it may depend on,
        parameters in functions of time, and initial values.
        """
        own, equations = self._own, self._equations
        texts = (text for path, text in self.spec.written.items() if path[0] != "model" or text.kind not in RECORDED)
        definitions = self.spec.parameters
        used, fresh = set[str](), set[str]().union(*map(names_in, texts))
        while fresh:
            used |= fresh
            fresh = set().union(*(names_in(definitions[name]) for name in fresh & definitions.keys())) - used
        unknown = {("parameters", name) for name in used}
        known = np.array([one.path[0] != "initial" and one.path not in unknown for one in parameters])
        is_possible = own.given is None
        if equations is not None:
            is_possible = equations.given.depend_on_coordinates_alone(self.initial)
        if self.mechanism.extensions or not (is_possible and np.any(known)):
            return None
        plain = [one for one, is_known in zip(parameters, known, strict=True) if is_known]
        values = np.array([one.value for one in plain])
        try:
            variant, exact, is_inside = self._formulas_at(plain, values)
        except (Exception, SystemExit):  # code computes in a way that cannot be recorded
            return None
        every = np.zeros((len(exact), len(parameters)))
        every[:, known] = exact
        slopes = arrays_from(variant.places, variant.base, every)
        known[known] = is_inside
        known &= np.all([np.isfinite(x).reshape(-1, len(parameters)).all(axis=0) for x in slopes.values()], axis=0)
        touched = {name: np.any(x.reshape(-1, len(parameters)), axis=0) for name, x in slopes.items()}
        never = np.zeros(len(parameters), dtype=bool)
        top = self.mechanism.topology
        of_laws = slopes.get("law_parameters", np.zeros((len(top.law_parameters), len(known))))
        of_functions = of_laws * self.mechanism.in_functions[:, None]
        moves = touched.get("motion_values", never)
        starts = touched.get("q", never) | touched.get("v", never) | touched.get("pair_parameters", never)
        starts = starts | np.any(of_functions, axis=0)
        if own.start.assembled.changed and equations is None:
            moves = moves | starts | touched.get("mass", never)
        known &= ~moves
        named = [one for one in plain if one.path[0] == "parameters"]
        if named and own.numbers:
            changed = [(one.path, one.value + 0.01 * self._scale(one)) for one in named]
            with suppress(SpecError):
                numbers = self._numbers(self._specs.spec([*self.values.items(), *changed]))
                if all(np.array_equal(x, own.numbers[name]) for name, x in numbers.items()):
                    named = []
            known &= np.array([one not in named for one in parameters])
        given = [slopes.pop(name, np.zeros((len(top.mass.ravel()), len(known)))) for name in "qv"]
        if np.any(starts & known):
            points = slopes.get("pair_parameters", np.zeros((*top.pair_parameters.shape, len(known))))
            both = points * known, of_functions * known
            if equations is None:
                bodies, fix = self.spec.mechanism().bodies, self.spec.mechanism().assembly.fix
                begin = StartDerivatives(own.start, self.spec.time.start, np.repeat([x in fix for x in bodies], 3))
                slopes |= begin.of(given[0] * known, given[1] * known, *both)
            else:
                slopes |= equations.by_numbers(*both)
        slopes = {name: x * known for name, x in slopes.items() if np.any(x[..., known])}
        none = np.zeros(len(parameters))
        return self._completed(slopes, parameters, none, none.astype(int)), known

    def _formulas_at(self, parameters: Sequence[Parameter], values: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray]:
        """Return the recorded formulas of the arrays as functions of parameters, their derivatives (R, K), and (K,)
        whether all conditions hold around the values (K,).
        """
        paths = tuple(one.path for one in parameters)
        others = tuple((path, value) for path, value in self.values.items() if path not in paths)
        formulas, latest = self._shared.formulas, self._shared.latest
        if paths not in formulas or formulas[paths][0] != others:

            def spec(numbers: Sequence[float]) -> RunSpec:
                if np.array_equal(numbers, values):
                    return self.spec
                return self._specs.spec([*others, *zip(paths, numbers, strict=True)])

            formulas[paths] = others, VariedNumbers(paths, spec, keeps_texts=True)
        key = paths, others, values.tobytes()
        if key not in latest:
            variant: Any = formulas[paths][1].variant(values.tolist())
            exact = derivatives_of(variant.formulas, values.tolist())
            sizes = np.array([WIDEST * self._scale(one) for one in parameters])
            around = np.minimum(sizes, np.where(values, 0.5 * np.abs(values), np.inf))
            latest.clear()
            latest[key] = variant, exact, inside(variant.formulas, values, around)
        return latest[key]

    def _by_differences(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        """Return derivatives by differences.

        One point for each parameter is enough if all arrays are linear in the parameters together, as another point
        shows in which all parameters differ, by unequal shares of their sizes.
        """
        with suppress(SpecError):
            if len(parameters) > 1:
                found = self.lines(parameters)
                shares = np.linspace(1.0, 2.0, len(parameters)) * FURTHER
                changed = [
                    replace(one, value=one.value + float(share * size))
                    for one, share, size in zip(parameters, shares, found.seeds.scale, strict=True)
                ]
                values = {one.path: one.value for one in changed if one.path[0] != "initial"}
                initial = {str(one.path[1]): one.value for one in changed if one.path[0] == "initial"}
                start, both = {**self.initial, **initial}, {**self.values, **values}
                made = self._specs, both, self._prepared, self._equations, self._shared
                other = RunPreparation(self._base, self._numbers, start, *made)
                known = np.array([one.value for one in parameters])
                both_sides = replace(found, side=0 * found.side)  # linear on the side on which the spec is valid
                if other.repeated(KnownDerivatives(known, self.mechanism, self.base, both_sides), changed) is not None:
                    return found
        return super().derivatives(parameters)

    def at(self, parameter: Parameter, value: float) -> Arrays:
        """Return the arrays for another value of a parameter; see `Preparation.at`."""
        if parameter.path[0] == "initial":
            return self._arrays(self._own, {**self.initial, str(parameter.path[1]): value}, self.base.get("q"))
        changed = self._with_values({**self.values, parameter.path: value})
        if changed.knots != self._own.knots:
            raise refused(
                f"the time at which a motion, or its derivative, is discontinuous depends on '{parameter.name}'; "
                f"there are no derivatives with respect to such a parameter"
            )
        self.require_same_form(changed.numbers, parameter)
        self.require_same_structure(changed.start.mechanism, parameter, value)
        return self._arrays(changed, self.initial, self.base.get("q"))


def knots_of(spec: RunSpec) -> tuple[float, ...]:
    """Return the times of all points of tables and all discontinuities of motions and loads in a run [s].

    Those at the start and at the end of the run are included.
    """
    corners = (corner for _, motion in spec.mechanism().motions() for corner in corners_of(motion, *spec.span))
    return tuple(sorted(corner.time for corner in corners))
