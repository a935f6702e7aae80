"""`sensitivities`: quantities of a run at given times, and their derivatives with respect to parameters.

Steps are differentiated like those of `gradient`. Times at the ends of fixed steps are rows of the run. Other times are
interpolated or, in runs with first-order states, reached by a smaller step. Runs that have no exact derivatives, such
as those with rigid contacts, are advanced as open simulations, and differentiated by central differences.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import gcd
from typing import Any

import numpy as np

from mbdkit.base import higher_layers
from mbdkit.base.errors import MbdkitError, RunError, SpecError
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import Path, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.engine.native.arithmetic import DIRECTIONS
from mbdkit.events.event_expression import RunExpression
from mbdkit.integrators.duals.dual_run import NO_SEEDS, Seeds
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.mechanism.parameters import names_in
from mbdkit.runs.preparation import RunSetup, make_method
from mbdkit.runs.stepping.open_simulation import open as open_simulation
from mbdkit.spec.loading import RunSource, load_spec
from mbdkit.spec.reading import variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_gradients.differentiated_expressions import numbers_in, slopes_of
from mbdkit_gradients.differentiated_run import Needs, differentiated_stepper, refuse
from mbdkit_gradients.differentiated_states import require_derivative, series_of
from mbdkit_gradients.gradient_parameters import Names, Parameter, read_names, resolved
from mbdkit_gradients.law_corners import with_sides
from mbdkit_gradients.parameter_differences import Arrays, KnownDerivatives, PreparedDerivatives
from mbdkit_gradients.prepared_derivatives import PreparedSpec, RunPreparation, SharedPreparation
from mbdkit_gradients.states_at_times import DifferentiatedRunAtTimes, RunAtTimes, Way

#: First part of the names of parameters that are initial values, such as ``initial.crank.angle``.
INITIAL = "initial"
ON_GRID = 1e-7  #: Times count as ends of fixed steps up to this share of a step.
CHANGE = 1e-5  #: Change of a parameter in central differences, as a share of its size.


@dataclass(frozen=True)
class Sensitivities:
    """Quantities of a run at given times, and their derivatives with respect to parameters.

    Attributes
    ----------
    quantities, units
        Expressions of the Q quantities, and their units; "" where a unit is not known.
    parameters
        Names of the K parameters.
    time
        (T,) times [s], as given.
    values
        (Q, T) values in SI units; nan where an expression is undefined.
    derivatives
        (Q, T, K) derivatives with respect to the parameters, in SI units.
    differences
        Why the derivatives are central differences of runs; empty if they are exact derivatives of the computed values.
    error
        (K,) estimated relative errors of the preparation of the run by each parameter; nan for central differences.
    """

    quantities: tuple[str, ...]
    units: tuple[str, ...]
    parameters: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    derivatives: np.ndarray
    differences: str
    error: np.ndarray

    def __getitem__(self, key: tuple[str, str]) -> np.ndarray:
        """Return the derivatives (T,) of a quantity with respect to a parameter."""
        quantity, parameter = key
        return np.asarray(self.derivatives[self.quantities.index(quantity), :, self.parameters.index(parameter)])

    def __str__(self) -> str:
        way = f"central differences, because {self.differences}" if self.differences else "exact derivatives"
        return (
            f"sensitivities of {listed(self.quantities, 'and')} at {len(self.time)} times with respect to "
            f"{listed(self.parameters, 'and')}: {way}"
        )


def sensitivities(
    source: RunSource,
    quantities: str | Sequence[str],
    times: Sequence[float] | np.ndarray,
    parameters: Names,
    *,
    initial: Mapping[str, float] | None = None,
    **sections: object,
) -> Sensitivities:
    """Return quantities of a run at given times, and their derivatives with respect to parameters.

    One run yields all times and all parameters. The derivatives are those of the computed numbers, for any step size,
    with first-order states, inputs and sampled controllers. Where they do not exist, as in runs with rigid contacts,
    they are central differences of runs; `Sensitivities.differences` then gives the reason.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism with its `sections`.
    quantities
        Expressions of the state, as in events: ``"crank.angle"``, ``"markers.tip.x"``, ``"joints.B.force"``.
    times
        (T,) times [s] between the start and the end of the run, in any order.
    parameters
        Names of `parameters` of the spec, key paths of numbers of its model such as ``model.bodies.rod.mass``, or
        initial values such as ``initial.crank.angle`` and ``initial.crank.angular_velocity``, which `initial` must
        contain. A mapping of names in `parameters` to numbers also sets these numbers.
    initial
        Initial values of kinematic quantities; see `mbdkit.prepare`.
    **sections
        Sections of the spec, such as ``time={"end": 1.0, "step": 0.01}``; they replace those of `source`.

    Raises
    ------
    SpecError
        If the input is wrong.
    RunError
        If the run ends before the last time.

    Examples
    --------
    >>> import mbdkit
    >>> time = {"end": 1.0, "step": 0.01}
    >>> found = mbdkit.sensitivities("pendulum", ["rod1.angle"], [0.5, 1.0], ["model.length"], time=time)
    >>> found.values.shape, found.derivatives.shape, found.differences
    ((1, 2), (1, 2, 1), '')
    """
    given, names = read_names(source, parameters, None, sections)
    if not names:
        raise SpecError("give at least one parameter", key="parameters")
    spec = load_spec(given, (), **sections)
    with one_thread_of_linear_algebra():
        return PreparedSensitivities(spec, quantities, times, names, initial=initial).at({}, initial)


class PreparedSensitivities:
    """Evaluates quantities of the runs of one spec at given times, for any values of its parameters.

    Parameters
    ----------
    spec
        The validated spec.
    quantities, times, names, initial
        See `sensitivities`.
    like
        Another one, whose spec has an equal model and equal parameters; work that depends on these alone is shared.

    Attributes
    ----------
    differences
        Why derivatives are central differences; empty if they are exact.

    Raises
    ------
    SpecError
        If the input is wrong.
    """

    def __init__(
        self,
        spec: RunSpec,
        quantities: str | Sequence[str],
        times: Sequence[float] | np.ndarray,
        names: Sequence[str],
        *,
        initial: Mapping[str, float] | None = None,
        like: PreparedSensitivities | None = None,
    ):
        self.spec, self.initial = spec, dict(initial or {})
        self.quantities = (quantities,) if isinstance(quantities, str) else tuple(quantities)
        self.time = _times(spec, times)
        self.sorted, self._places = np.unique(self.time, return_inverse=True)
        self._names = names
        self.parameters = tuple(self._valued(spec, self.initial))
        self._expressions = self._parsed(spec)
        self._uses_parameters = bool(set().union(*map(names_in, self.quantities)) & spec.parameters.keys())
        self.units = tuple(_unit(text, spec) for text in self.quantities)
        self.differences = self._why_differences()
        self._grid = _grid(spec, self.sorted)
        self._way: Way = "rows" if self._grid is not None else "ends" if is_smooth(spec) else "within"
        self._shared: SharedPreparation = SharedPreparation() if like is None else like._shared
        self._specs = VariedSpecs(spec.canonical_json(), self._shared.specs)
        self._preparations: dict[object, RunPreparation] = {}
        self._known: dict[object, KnownDerivatives] = {}
        self._prepared_at: tuple[tuple[Mapping[Path, float], bool], dict[Any, PreparedSpec]] = ({}, False), {}

    @cached_property
    def _prepared(self) -> Any:  # a `PreparedRun`, of a part above
        return higher_layers.prepared_run(self.spec)

    def _parsed(self, spec: RunSpec) -> list[RunExpression]:
        found = []
        for text in self.quantities:
            if not isinstance(text, str):
                raise SpecError(f"a quantity is an expression, not {value_text(text)}", key="quantities")
            with SpecError.locate("quantities"):
                found.append(RunExpression.parse(text, spec.mechanism(), spec.numbers, crosses=False))
        return found

    def _numbers(self, spec: RunSpec) -> Arrays:
        """Return the numbers in the instructions of the quantities that contain parameters."""
        if not self._uses_parameters:
            return {}
        return numbers_in({str(index): one for index, one in enumerate(self._parsed(spec))}, "quantities")

    def _why_differences(self) -> str:
        """Return why runs of the spec have no exact derivatives; empty if they have."""
        spec = self.spec
        if any(event.action != "note" or event.set for event in spec.events.values()):
            return "an event ends the run or sets states"
        try:
            refuse(spec, make_method(spec))
            for one in self._expressions:
                for quantity in one.quantities:
                    require_derivative(quantity)
            differentiated_stepper(spec, NO_SEEDS, Needs(), None)
        except MbdkitError as error:
            return (error.message if isinstance(error, SpecError) else str(error)).rstrip(".")
        return ""

    # ---- evaluation ------------------------------------------------------------------------------------------------

    def at(self, values: Mapping[str, float], initial: Mapping[str, float] | None = None) -> Sensitivities:
        """Return the quantities and their derivatives for values of named parameters, and initial values.

        Parameters
        ----------
        values
            Values of parameters by name, of those to be differentiated and of others; names of initial values may be
            among them. Others keep the values of the spec.
        initial
            Initial values; by default, those that were given first.

        Raises
        ------
        SpecError
            If the spec is not valid with these values.
        RunError
            If the run ends before the last time.
        """
        plain, start = self._split(values, initial)
        names = self.quantities, self.units, tuple(parameter.name for parameter in self.parameters), self.time
        if not self.parameters:
            found = self.values(values, initial)
            return Sensitivities(*names, found, np.zeros((*found.shape, 0)), self.differences, np.zeros(0))
        exact, some = None, self._places
        if not self.differences:
            try:
                exact = self._exact(plain, start)
            except SpecError as failure:
                if failure.key != "gradients":
                    raise
                self.differences = failure.message.rstrip(".")
        found, slopes, error = exact or self._by_differences(plain, start)
        return Sensitivities(*names, found[:, some], slopes[:, some], self.differences, error)

    def values(self, values: Mapping[str, float], initial: Mapping[str, float] | None = None) -> np.ndarray:
        """Return the quantities (Q, T) without derivatives; see `at`."""
        plain, start = self._split(values, initial)
        if self.differences:
            found = self._stepped(plain, start)
        else:
            found, _ = self._states(self._preparation(plain, start), NO_SEEDS)
        return np.asarray(found[:, self._places])

    def _split(
        self, values: Mapping[str, float], initial: Mapping[str, float] | None
    ) -> tuple[dict[str, float], dict[str, float]]:
        start = dict(self.initial if initial is None else initial)
        plain = {}
        for name, value in values.items():
            if name.startswith(f"{INITIAL}."):
                start[name.removeprefix(f"{INITIAL}.")] = float(value)
            else:
                plain[name] = float(value)
        return plain, start

    # ---- exact derivatives -----------------------------------------------------------------------------------------

    def _preparation(self, plain: Mapping[str, float], start: Mapping[str, float]) -> RunPreparation:
        values = {variable_path(name): value for name, value in plain.items()}
        if (values, bool(start)) != self._prepared_at[0]:
            self._prepared_at, self._preparations = ((values, bool(start)), {}), {}
        key = tuple(start.items())
        if key not in self._preparations:
            self._preparations[key] = RunPreparation(
                self.spec, self._numbers, start, self._specs, values, self._prepared_at[1], shared=self._shared
            )
        return self._preparations[key]

    def _exact(
        self, plain: Mapping[str, float], start: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return values (Q, T), derivatives (Q, T, K) and their errors (K,) at the sorted times."""
        preparation = self._preparation(plain, start)
        prepared = self._derivatives(preparation, start)
        values, slopes = np.empty((len(self.quantities), len(self.sorted))), []
        for first in range(0, len(self.parameters), DIRECTIONS):
            values, slope = self._states(preparation, prepared.seeds.only(slice(first, first + DIRECTIONS)))
            slopes.append(slope)
        return values, np.concatenate(slopes, axis=-1), prepared.error

    def _derivatives(self, preparation: RunPreparation, start: Mapping[str, float]) -> PreparedDerivatives:
        """Return the derivatives of a preparation; those that are known are used again while arrays are linear."""
        parameters = self._valued(preparation.spec, start)
        differentiated = {one.path[1] for one in parameters if one.path[0] == INITIAL}
        own = {one.path for one in parameters}
        fixed: tuple[object, ...] = tuple(item for item in start.items() if item[0] not in differentiated)
        fixed += tuple((path, value) for path, value in preparation.values.items() if path not in own)
        known = self._known.get(fixed)
        found = None if known is None else preparation.repeated(known, parameters)
        if found is None:
            values = np.array([one.value for one in parameters])
            found = preparation.derivatives(parameters)
            self._known[fixed] = KnownDerivatives(values, preparation.mechanism, preparation.base, found)
        return found

    def _valued(self, spec: RunSpec, start: Mapping[str, float]) -> list[Parameter]:
        """Return the parameters with their present values."""
        plain = [name for name in self._names if not name.startswith(f"{INITIAL}.")]
        known = dict(zip(plain, resolved(spec, plain), strict=True)) if plain else {}
        return [known[name] if name in known else _initial(name, start) for name in self._names]

    def _states(self, preparation: RunPreparation, seeds: Seeds) -> tuple[np.ndarray, np.ndarray]:
        """Return values (Q, T) and derivatives (Q, T, K) at the sorted times."""
        spec, setup = preparation.spec, preparation.setup
        expressions = self._parsed(spec) if self._uses_parameters else self._expressions
        count = seeds.count
        uses_accelerations, way = not setup.method.traits.suits_stiff, self._way
        changes: dict[str, Any] = {"every": self._grid or 1, "interval": None, "single": way == "within"}
        run: RunAtTimes
        if count:
            stepper = differentiated_stepper(spec, seeds, Needs(), None, setup, **changes)
            run = DifferentiatedRunAtTimes(stepper, count, way, uses_accelerations=uses_accelerations)
        else:
            plain = setup.stepper(replace(setup.timetable(), **changes))
            run = RunAtTimes(plain, setup.workspace, way, uses_accelerations=uses_accelerations)
        paths = {quantity.recorded.array.path for one in expressions for quantity in one.quantities}
        states = run.states(self.sorted, is_kinematic=paths <= KINEMATIC)
        values = np.empty((len(expressions), len(self.sorted)))
        slopes = np.empty((*values.shape, seeds.count))
        for index, one in enumerate(expressions):
            found = series_of(one, states, slopes_of(one.program, seeds, f"quantities.{index}"))
            values[index], slopes[index].T[...] = found.value, found.slope
        return values, slopes

    # ---- central differences ---------------------------------------------------------------------------------------

    def _by_differences(
        self, plain: Mapping[str, float], start: Mapping[str, float]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return values (Q, T), central differences (Q, T, K) and their errors (K,) at the sorted times.

        Differences are one-sided if the spec is valid on one side of a parameter only.
        """
        here, slopes = self._stepped(plain, start), []
        for one in self._valued(self._prepared.spec_with(plain), start):
            is_initial = one.path[0] == INITIAL
            change = CHANGE * max(abs(one.value), 1.0 if is_initial else 0.0) or CHANGE
            ends = []
            for value in (one.value + change, one.value - change):
                moved = {str(one.path[-1]) if is_initial else one.name: value}
                given = (plain, {**start, **moved}) if is_initial else ({**plain, **moved}, start)
                try:
                    ends.append((value, self._stepped(*given)))
                except SpecError:  # the difference is one-sided
                    ends.append((one.value, here))
            (high, above), (low, below) = ends
            if high == low:
                message = f"the spec is not valid for values close to {one.value!r} of '{one.name}'"
                raise SpecError(message, key="parameters")
            slopes.append((above - below) / (high - low))
        return here, np.stack(slopes, axis=-1), np.full(len(slopes), np.nan)

    def _stepped(self, plain: Mapping[str, float], start: Mapping[str, float]) -> np.ndarray:
        """Return the quantities (Q, T) at the sorted times, from a simulation that is advanced to each of them."""
        spec = self._prepared.spec_with(plain, start) if start else self._prepared.spec_with(plain)
        found = np.empty((len(self.quantities), len(self.sorted)))
        with open_simulation(spec) as simulation:
            read = simulation.reader(list(self.quantities))
            for column, time in enumerate(self.sorted.tolist()):
                if time > simulation.time and not simulation.ended:
                    simulation.advance_to(time)
                if simulation.time < time * (1.0 - ON_GRID):
                    raise RunError(f"the run ends before t = {time:.6g} s: {simulation.ended}")
                found[:, column] = read()
        return found


#: Arrays of quantities that depend on positions, velocities and first-order states, but not on forces.
KINEMATIC = {
    "trajectory/position", "trajectory/velocity", "joints/angle", "markers/position", "markers/velocity",
    "forces/length", "forces/rate", "states/value", "inputs/value",
}  # fmt: skip


def is_smooth(spec: RunSpec) -> bool:
    """Return whether motion is smooth between the ends of steps, so that states can be interpolated: without stops,
    first-order states, and force laws with discontinuities.
    """
    mechanism, setup = spec.mechanism(), RunSetup.of(spec)
    if setup.timetable().stops or mechanism.state_names() or mechanism.held_names():
        return False
    return with_sides(setup.workspace.mechanism) is None


def _initial(name: str, start: Mapping[str, float]) -> Parameter:
    quantity = name.removeprefix(f"{INITIAL}.")
    if quantity not in start:
        hint = did_you_mean(quantity, list(start)) or f"; `initial` has {listed([*start]) or 'none'}"
        raise SpecError(f"there is no initial value of '{quantity}'{hint}", key="parameters")
    return Parameter(name, (INITIAL, quantity), float(start[quantity]))


def _unit(text: str, spec: RunSpec) -> str:
    try:
        return MeasureExpression.parse(f"final(abs({text}))", spec).unit.text
    except SpecError:  # the unit of a parameter is not known
        return ""


def _times(spec: RunSpec, given: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return times (T,); raise SpecError unless they are within the run."""
    try:
        times: np.ndarray = np.atleast_1d(np.asarray(given, float))
    except (TypeError, ValueError):
        raise SpecError("times are numbers [s]", key="times") from None
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)):
        raise SpecError("give a list of finite times [s]", key="times")
    start, end = spec.time.start, spec.time.final
    margin = 1e-12 * max(abs(start), abs(end))
    outside = times[(times < start - margin) | (times > end + margin)]
    if len(outside):
        raise SpecError(f"{outside[0]:.9g} s is outside of the run, from {start:g} s to {end:g} s", key="times")
    return np.asarray(np.clip(times, start, end))


def _grid(spec: RunSpec, times: np.ndarray) -> int | None:
    """Return the number of fixed steps between two of the times; None if they are not ends of fixed steps."""
    step = spec.time.step
    if step is None or spec.claims.adaptive or spec.reacting is not None:
        return None
    places = (times - spec.time.start) / step
    whole = np.round(places)
    if np.any(np.abs(places - whole) > ON_GRID):
        return None
    return int(max(1, gcd(*whole.astype(int).tolist())))
