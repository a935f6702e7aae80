"""`gradient`: measures of a run and their exact derivatives with respect to parameters of its model."""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Generic, Self, TypeVar

import numpy as np

from mbdkit.base.errors import MbdkitError, RunError, SpecError
from mbdkit.base.html_view import HtmlView
from mbdkit.base.one_thread import one_thread_of_linear_algebra
from mbdkit.base.plain_data import path_text
from mbdkit.base.text import listed, plus_minus
from mbdkit.engine.consistent_start import Starts
from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedStepper
from mbdkit.integrators.duals.dual_run import NO_SEEDS
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.methods.kinds import Method
from mbdkit.runs.preparation import RunSetup, make_method, written_forces
from mbdkit.runs.run_criteria import zero_reactions_in
from mbdkit.spec.loading import RunSource, load_spec
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import variable_path
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.sections import GradientMode
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit.trust.finding import Doubts
from mbdkit.trust.measure_error import natural_scales, natural_size
from mbdkit_gradients.adjoint_gradient import AdjointRun, why_forward
from mbdkit_gradients.adjoint_measures import NotByAdjointError
from mbdkit_gradients.backward_sweep import is_ready
from mbdkit_gradients.derivative_doubts import start_doubts
from mbdkit_gradients.differentiated_expressions import Definitions, Measures, definitions_of, expressions_of
from mbdkit_gradients.differentiated_run import DifferentiatedRun, Needs, differentiated_run, refuse
from mbdkit_gradients.differentiated_states import require_derivative
from mbdkit_gradients.gradient_check import (
    DIGITS,
    NATURAL,
    Direction,
    GradientCheck,
    Settings,
    check_doubts,
    check_gradient,
)
from mbdkit_gradients.gradient_parameters import Names, Parameter, read_names, resolved
from mbdkit_gradients.law_corners import with_sides
from mbdkit_gradients.measured_derivatives import DerivedMeasure, derived_measures, needs_of
from mbdkit_gradients.other_method import Reference, measured_values
from mbdkit_gradients.parameter_differences import PreparedDerivatives
from mbdkit_gradients.prepared_derivatives import (
    RunPreparation,
    SharedPreparation,
    numbers_of_run,
    prepared_derivatives,
)
from mbdkit_report import Cell, Column, Table, View, columns_of
from mbdkit_report.notebook.result_views import object_view


@dataclass(frozen=True)
class Gradient(HtmlView):
    """Measures of a run, and their derivatives with respect to parameters.

    Attributes
    ----------
    measures, units
        Names of the M measures, and their units.
    parameters
        Names of the K parameters, in the given order.
    value
        (M,) values of the measures.
    jacobian
        (M, K) derivatives of the measures with respect to the parameters, in the unit of the measure per SI unit of the
        parameter.
    preparation_error
        (K,) estimated relative errors of the derivatives of the compiled mechanism and its start; 0 where exact.
    doubts
        Warnings of the run that question its results, and warnings about measures that have no derivative, such as the
        largest of two equal peaks, about parameters that are initial values which assembly changes, and about checks
        that fail.
    check
        Comparison of the gradient with differences of runs and with the gradient of another method; None if it was not
        requested.
    remarks
        Notes that do not question the derivatives: warnings of the run that do not question its results, reactions that
        are always zero, and extrema at the end of the run, which a longer run may exceed.
    """

    measures: tuple[str, ...]
    units: tuple[str, ...]
    parameters: tuple[str, ...]
    value: np.ndarray
    jacobian: np.ndarray
    preparation_error: np.ndarray
    doubts: tuple[str, ...]
    check: GradientCheck | None
    remarks: tuple[str, ...] = ()

    @property
    def error(self) -> np.ndarray:
        """(M, K) estimated errors of `jacobian`; nan where unknown, as without check.

        They are distances from the derivatives of the exact motion, and include the discretization error.
        """
        return np.full(self.jacobian.shape, np.nan) if self.check is None else self.check.entry_error

    def texts(self, measure: str, sign: str = "+-") -> list[str]:
        """Return the derivatives of a measure as text, with their errors and as many digits as these justify."""
        m = self.measures.index(measure)
        if self.check is None:
            return [f"{x:.{DIGITS}g}" for x in self.jacobian[m]]
        return [plus_minus(x, e, sign, DIGITS) for x, e in zip(self.jacobian[m], self.error[m], strict=True)]

    def __getitem__(self, key: tuple[str, str]) -> float:
        measure, parameter = key
        return float(self.jacobian[self.measures.index(measure), self.parameters.index(parameter)])

    def described(self, measure: str) -> dict[str, Any]:
        """Return unit, derivatives and their errors by name of the parameter, doubts if there are any, and check of one
        measure as plain data. Numbers that are not finite become None.
        """
        m = self.measures.index(measure)
        found: dict[str, Any] = {
            "unit": self.units[m],
            "derivatives": dict(zip(self.parameters, map(_finite, self.jacobian[m]), strict=True)),
        }
        if self.doubts:
            found["doubts"] = list(self.doubts)
        if self.check is not None:
            check = self.check
            found["errors"] = dict(zip(self.parameters, map(_finite, self.error[m]), strict=True))
            found["check"] = {
                "derivative": _finite(check.derivative[m]),
                "differences": [_finite(x) for x in check.differences[:, m]],
                "extrapolated": _finite(check.extrapolated[m]),
                "error": _finite(check.error[m]),
                "reference": _finite(check.reference[m]),
                "agrees": bool(check.agrees[m]),
            }
        return found

    def __str__(self) -> str:
        lines = []
        for name, unit, value in zip(self.measures, self.units, self.value, strict=True):
            lines.append(f"{name} = {value:.12g} {unit}".rstrip())
            width = max(map(len, self.parameters))
            lines += [
                f"  by {parameter:{width}}  {'' if text.startswith('-') else ' '}{text}"
                for parameter, text in zip(self.parameters, self.texts(name), strict=True)
            ]
        lines += self.doubts
        lines += self.remarks
        if self.check is not None:
            lines.append(str(self.check))
        return "\n".join(lines)


def _finite(x: float) -> float | None:
    return float(x) if math.isfinite(x) else None


def gradient(
    source: RunSource,
    measures: Measures,
    names: Names | None = None,
    *,
    parameters: Names | None = None,
    check: bool = True,
    mode: GradientMode = "auto",
    **sections: object,
) -> Gradient:
    """Run a spec, and return the exact derivatives of measures of the run with respect to parameters of its model.

    Every step of the method is differentiated, so that the result is the derivative of the computed numbers for any
    step size. It includes the dependence of the initial state on the parameters, also the dependence due to assembly.

    Parameters
    ----------
    source
        A file name, the name of a packaged example, a mapping, a RunSpec, or a Mechanism with its `sections`.
    measures
        Expressions such as ``"max(abs(joints.B.force))"``: one, several, or a mapping as in the section `measures` of a
        spec. Names of measures that the spec defines may stand for their expressions.
    names
        Names of `parameters` of the spec, or key paths of numbers of its model such as ``model.bodies.rod.mass``. A
        mapping of names in `parameters` to numbers also sets these numbers.
    parameters
        With `names`, the section `parameters` of the spec, as in `mbdkit.run`. Without `names`, the names.
    check
        Whether to check the gradient, and to estimate the errors of its entries, by up to ten runs and a gradient by
        another method.
    mode
        ``forward`` carries the derivatives with respect to all parameters through every step; ``adjoint`` carries those
        of each measure back from the end to the start, which costs a few runs for any number of parameters; ``auto``
        takes the adjoint for many parameters where it is available.
    **sections
        Sections of the spec, such as ``time={"end": 1.0, "step": 0.01}``; they replace those of `source`.

    Returns
    -------
    Gradient
        Values, derivatives and check. A check that fails is part of the result, not an error.

    Raises
    ------
    SpecError
        If the input is wrong, if a measure or runs of this spec have no derivatives, or if the adjoint does not give
        them and is asked for.
    RunError
        If the run stops early.

    Examples
    --------
    >>> import mbdkit
    >>> run = {"integrator": {"name": "gauss", "stages": 3}, "time": {"end": 1.0, "step": 0.01}}
    >>> found = mbdkit.gradient("pendulum", "final(bodies.rod1.angle)", "model.length", **run)
    >>> found.jacobian.shape
    (1, 1)
    >>> found.check.is_passed
    True
    """
    with one_thread_of_linear_algebra():
        problem, chosen = _RunProblem.asked(load_spec, source, measures, names, parameters, sections)
        problem.mode = mode
        found = problem.gradient(chosen, check=check)
    spec = problem.spec
    of_spec = RunSetup.of(spec, problem.starts).findings([one.text for one in problem.expressions.values()])
    of_run = Doubts.of(of_spec, spec.accept).open
    notes = [text for text in map(str, of_spec) if text not in of_run]
    known = {measure.expression for measure in spec.defined_measures()}
    for name, expression in problem.expressions.items():
        if expression.text not in known:  # otherwise, the warnings contain the notes on it
            notes += zero_reactions_in(spec, f"'{name}'", expression)
    return replace(found, doubts=(*of_run, *found.doubts), remarks=tuple(dict.fromkeys((*notes, *found.remarks))))


def asked_gradients(spec: RunSpec) -> tuple[list[str], GradientMode]:
    """Return the names of the parameters in the key `gradients` of a spec, and the mode."""
    asked = spec.gradients
    return (asked, "auto") if isinstance(asked, list) else (asked.parameters, asked.mode)


def check_gradients(spec: RunSpec, method: Method) -> None:
    """Raise SpecError, with the key, if the gradients requested by a spec cannot be computed."""
    with SpecError.place_by(spec.placed):
        if not spec.measures:
            raise SpecError("gradients are derivatives of measures, but the spec has no `measures`", key="gradients")
        names, _ = asked_gradients(spec)
        key = ("gradients",) if isinstance(spec.gradients, list) else ("gradients", "parameters")
        for index, name in enumerate(names):
            with SpecError.rekey(path_text((*key, index))):
                resolved(spec, [name])
        resolved(spec, names)
        require_derivatives(expressions_of(spec, definitions_of(spec, list(spec.measures))))
        refuse(spec, method)


def require_derivatives(expressions: Mapping[str, MeasureExpression]) -> None:
    """Raise SpecError, with the name of the measure, if the measure contains a quantity that has no derivative."""
    for name, expression in expressions.items():
        for quantity in expression.quantities:
            with SpecError.rekey(path_text(("measures", name))):
                require_derivative(quantity)


def gradients_json(spec: RunSpec) -> str:
    """Return the gradients requested by a spec, or the reason why there are none, as the attribute of an archive."""
    try:
        with one_thread_of_linear_algebra():
            definitions = definitions_of(spec, list(spec.measures))
            names, mode = asked_gradients(spec)
            problem = _RunProblem(spec, definitions)
            problem.mode = mode
            found = problem.gradient(resolved(spec, names), check=True)
    except MbdkitError as error:
        text = {name: {"reason": str(error)} for name in spec.measures}
    else:
        text = {name: found.described(name) for name in found.measures}
    return json.dumps(text, ensure_ascii=False, allow_nan=False)


def gradient_of_run_spec(
    spec: RunSpec, definitions: Definitions, parameters: Sequence[Parameter], *, check: bool
) -> Gradient:
    """Return the gradient of measures of a run; see `gradient`."""
    return _RunProblem(spec, definitions).gradient(parameters, check=check)


S = TypeVar("S", bound=ModelSpec)


def gradients_at(spec: RunSpec, measures: Measures, names: Sequence[str]) -> Callable[[Mapping[str, float]], Gradient]:
    """Return a function that returns the gradient, without its check, of the run of a spec with other numbers, given
    by name of a parameter or by key. The runs share their preparation.

    `measures`, `names`: see `gradient`. Raises SpecError if a measure, a name, or runs of the spec have no derivatives.
    """
    definitions, shared = definitions_of(spec, measures), SharedPreparation()
    _RunProblem(spec, definitions)
    resolved(spec, names)
    refuse(spec, make_method(spec))

    def gradient_at(numbers: Mapping[str, float]) -> Gradient:
        values = {variable_path(name): value for name, value in numbers.items()}
        with one_thread_of_linear_algebra():
            preparation = RunPreparation(
                spec, partial(numbers_of_run, definitions=definitions), values=values, shared=shared
            )
            problem = _RunProblem(preparation.spec, definitions, preparation)
            return problem.gradient(resolved(problem.spec, names), check=False)

    return gradient_at


class GradientProblem(ABC, Generic[S]):
    """A spec and its measures, whose gradient is computed in the same way for runs and for other kinds of specs.

    Parameters
    ----------
    spec
        The validated spec.
    definitions
        The measures.

    Raises
    ------
    SpecError
        If an expression is not valid, or contains a quantity that has no derivative.
    """

    def __init__(self, spec: S, definitions: Definitions):
        self.spec, self.definitions = spec, definitions
        self.expressions = expressions_of(spec, definitions)
        require_derivatives(self.expressions)

    @classmethod
    def asked(
        cls,
        load: Callable[..., S],
        source: object,
        measures: Measures,
        names: Names | None,
        parameters: Names | Mapping[str, object] | None,
        sections: dict[str, object],
    ) -> tuple[Self, tuple[Parameter, ...]]:
        """Return the problem of a source that `load` reads, and its parameters; see `mbdkit.gradient`."""
        source, wanted = read_names(source, names, parameters, sections)
        spec = load(source, (), **sections)
        return cls(spec, definitions_of(spec, measures)), resolved(spec, wanted)

    @abstractmethod
    def prepared(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        """Return the derivatives of the arrays from which the states are computed."""

    @abstractmethod
    def run(self, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> DifferentiatedRun:
        """Return the states with derivatives with respect to the parameters."""

    def differentiated(
        self, parameters: Sequence[Parameter], prepared: PreparedDerivatives
    ) -> tuple[Any, Mapping[str, DerivedMeasure]]:
        """Return a `DifferentiatedRun` or an `AdjointRun`, and its measures with their derivatives."""
        run = self.run(parameters, prepared)
        return run, derived_measures(run, self.expressions, prepared.seeds)

    @abstractmethod
    def measured(self, run: DifferentiatedRun, settings: Settings) -> list[float]:
        """Return the measures for other values of the parameters than those of `run`; nan if the computation fails."""

    def reference(self, run: DifferentiatedRun, prepared: PreparedDerivatives) -> Reference | None:
        """Return the measures by another, more accurate method; None if the computation has no steps."""
        return None

    def advice(self, run: DifferentiatedRun) -> str:
        """Return a clause that names forces that are not smooth in the run, and says what helps; empty for none."""
        return ""

    def gradient(self, parameters: Sequence[Parameter], *, check: bool) -> Gradient:
        """Return the gradient with respect to parameters, with its check unless `check` is false."""
        prepared = self.prepared(parameters)
        run, derived = self.differentiated(parameters, prepared)
        doubts = [*run.doubts, *(doubt for one in derived.values() for doubt in one.doubts)]
        value = np.array([one.value for one in derived.values()])
        jacobian = np.array([one.slope for one in derived.values()]).reshape(len(derived), len(parameters))
        checked = None
        if check:
            reference = self.reference(run, prepared)
            by_another = (None, None) if reference is None else (reference.values, reference.jacobian)
            direction, sizes = Direction.random(parameters, prepared), self._sizes(run, derived)
            checked = check_gradient(direction, partial(self.measured, run), sizes, value, jacobian, *by_another)
            doubts += check_doubts(checked, partial(self.advice, run))
        return Gradient(
            measures=tuple(self.expressions),
            units=tuple(expression.unit.text for expression in self.expressions.values()),
            parameters=tuple(parameter.name for parameter in parameters),
            value=value,
            jacobian=jacobian,
            preparation_error=prepared.error,
            doubts=tuple(doubts),
            check=checked,
            remarks=tuple(f"{name}: {remark}" for name, one in derived.items() for remark in one.remarks),
        )

    def _sizes(self, run: DifferentiatedRun | AdjointRun, derived: Mapping[str, DerivedMeasure]) -> dict[str, float]:
        """Return the magnitudes of the numbers from which the measures are computed."""
        mechanism, duration = run.rows.mechanism, float(np.ptp(run.rows.time))
        mass = float(np.max(mechanism.topology.mass[:-1, 0], initial=0.0))
        scales = natural_scales(mechanism.length, mass, mechanism.topology.gravity.tolist(), duration)
        natural = {name: natural_size(expression.unit, *scales) for name, expression in self.expressions.items()}
        return {name: max(abs(one.value), one.size, NATURAL * natural[name]) for name, one in derived.items()}


#: Smallest number of parameters for which the adjoint, if it is available, is chosen by itself.
FEW = 9


class _RunProblem(GradientProblem[RunSpec]):
    """A run with its measures."""

    mode: GradientMode = "auto"

    def __init__(self, spec: RunSpec, definitions: Definitions, preparation: RunPreparation | None = None):
        super().__init__(spec, definitions)
        self._preparation, self.starts = preparation, Starts()
        every = [needs_of(expression) for expression in self.expressions.values()]
        self._needs = Needs(any(one.nodes for one in every), any(one.ends for one in every))

    @cached_property
    def _specs(self) -> VariedSpecs:
        apart: dict[str, Any] = {"measures": {}, "gradients": [], "check": False}
        return VariedSpecs(RunSpec(**self.spec.sections() | apart).canonical_json())

    def prepared(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        if self._preparation is not None:
            return self._preparation.derivatives(parameters)
        return prepared_derivatives(self.spec, parameters, self.definitions, self.starts)

    def run(self, parameters: Sequence[Parameter], prepared: PreparedDerivatives) -> DifferentiatedRun:
        run = differentiated_run(self.spec, prepared.seeds, self._needs)
        return replace(run, doubts=(*start_doubts(self.spec, parameters, prepared), *run.doubts))

    def differentiated(
        self, parameters: Sequence[Parameter], prepared: PreparedDerivatives
    ) -> tuple[Any, Mapping[str, DerivedMeasure]]:
        if self.mode == "forward" or (self.mode == "auto" and not (len(parameters) >= FEW and is_ready())):
            return super().differentiated(parameters, prepared)
        refuse(self.spec, make_method(self.spec))
        try:
            if why := why_forward(self.spec, make_method(self.spec), prepared.seeds):
                raise NotByAdjointError(why)
            run = AdjointRun(self.spec, prepared.seeds, self._needs, self.starts)
            derived = run.measures(self.expressions)
        except NotByAdjointError as error:
            if self.mode == "adjoint":
                message = f"the adjoint does not give this gradient: {error}; use mode: forward"
                raise SpecError(message, key="gradients") from None
            return super().differentiated(parameters, prepared)
        run.doubts = (*start_doubts(self.spec, parameters, prepared), *run.doubts)
        return run, derived

    def measured(self, run: DifferentiatedRun | AdjointRun, settings: Settings) -> list[float]:
        spec = self._specs.spec(settings)
        expressions = expressions_of(spec, self.definitions) if self.spec.parameters else self.expressions
        unknown = [np.nan] * len(expressions)
        if self._needs == Needs() and not spec.events and not run.is_split and run.sizes is None:
            return measured_values(expressions, spec) or unknown
        try:
            # Step sizes that depend on the parameters would change the differences by a multiple of the tolerance.
            other = differentiated_run(spec, NO_SEEDS, self._needs, sizes=run.sizes)
        except RunError:
            return unknown
        return [measure.value for measure in derived_measures(other, expressions, NO_SEEDS).values()]

    def advice(self, run: DifferentiatedRun | AdjointRun) -> str:
        workspace = RunSetup.of(self.spec).workspace
        sided = with_sides(workspace.mechanism)
        known = [] if sided is None else [condition.force for condition in sided.conditions]
        names = [name for name in DifferentiatedStepper.forces_that_switch(workspace, run.rows) if name not in known]
        texts = written_forces(self.spec, names)
        if workspace.mechanism.treatments and not self.spec.claims.adaptive:
            texts.append("a contact that begins or ends")
        if not texts:
            return ""
        what = f"{listed(texts, 'or')} is not smooth at a state that the run passes"
        if not self.spec.claims.adaptive:
            return f"{what}, and fixed steps do not end there; use a method with `adaptive: true`, whose steps do"
        return f"{what}; if a force jumps there, let it change over a small range instead, as `tanh` does"

    def reference(self, run: DifferentiatedRun | AdjointRun, prepared: PreparedDerivatives) -> Reference:
        return Reference(self.spec, self.expressions, prepared, self._needs, isinstance(run, AdjointRun))


@object_view
def gradient_view(found: Gradient) -> View:
    """Return the view of a gradient."""
    columns = [*columns_of("measure; unit; value"), *(Column(f"by {name}") for name in found.parameters)]
    rows: list[tuple[Cell, ...]] = [
        (name, unit, float(value), *found.texts(name, "\u00b1"))
        for name, unit, value in zip(found.measures, found.units, found.value, strict=True)
    ]
    check = () if found.check is None else (str(found.check),)
    note = "In the unit of the measure for each SI unit of the parameter."
    table = Table("gradient", "Derivatives", tuple(columns), tuple(rows), note)
    return View("Gradient", (*found.doubts, *found.remarks, *check), tables=(table,))
