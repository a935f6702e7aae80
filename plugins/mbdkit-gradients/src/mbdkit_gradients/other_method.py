"""Measures of a run by another, more accurate method, and their gradient, from which errors of derivatives follow."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.native.arithmetic import DIRECTIONS
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.runs.accuracy.compared_measures import other_methods, with_other_steps, with_sections
from mbdkit.runs.preparation import RunSetup, make_method
from mbdkit.runs.simulation import measured_in
from mbdkit.spec.run_spec import RunSpec
from mbdkit.spec.varied_specs import VariedSpecs
from mbdkit_gradients.adjoint_gradient import AdjointRun, why_forward
from mbdkit_gradients.adjoint_measures import NotByAdjointError
from mbdkit_gradients.differentiated_run import Needs, differentiated_run
from mbdkit_gradients.gradient_check import Settings
from mbdkit_gradients.measured_derivatives import derived_measures
from mbdkit_gradients.parameter_differences import PreparedDerivatives

#: Assumed number of steps of a run, from which the step limit of the other method is computed.
ASSUMED_STEPS = 2_000
#: Smallest number of steps and smallest tolerance of the differentiated run by the other method.
#:
#: They are not as strict as those of the runs for differences, which would show a short pulse that these steps miss.
STEPS, TOLERANCE = 200, 1e-11
#: Largest number of parameters for which the run by another method is differentiated forward if its adjoint fails.
#:
#: Time and memory of forward derivatives grow with the number of parameters.
MOST_FORWARD = 4 * DIRECTIONS


@dataclass
class Reference:
    """Measures by another, more accurate method than that of a run.

    Parameters
    ----------
    spec, expressions
        The run and its measures.
    prepared
        Derivatives of the preparation of the run.
    needs
        Data that the measures need.
    by_adjoint
        Whether the adjoint gives the gradient if it can.
    """

    spec: RunSpec
    expressions: Mapping[str, MeasureExpression]
    prepared: PreparedDerivatives
    needs: Needs
    by_adjoint: bool = False

    def __post_init__(self) -> None:
        self._specs = VariedSpecs(self.spec.canonical_json())
        self._chosen: int | None = None

    def values(self, settings: Settings) -> Sequence[float]:
        """Return the measures (M,) of a run with other values of parameters; nan if no method reaches its end."""
        spec = self._specs.spec(settings)
        others = self._others(spec, _recorded_interval(spec))  # `at` may interpolate between recorded states
        for place in range(len(others)) if self._chosen is None else [self._chosen]:
            if found := measured_values(self.expressions, others[place]):
                self._chosen = place
                return found
        return [math.nan] * len(self.expressions)

    def jacobian(self) -> np.ndarray:
        """Return the derivatives (M, K) of the measures by the method that `values` has chosen; nan if they are not
        available.
        """
        unknown = np.full((len(self.expressions), self.prepared.seeds.count), np.nan)
        if self._chosen is None:
            return unknown
        other = self._others(self.spec, None)[self._chosen]
        step = (self.spec.time.final - self.spec.time.start) / STEPS
        other = with_other_steps(other, step, tightest=TOLERANCE)
        is_short = not self.by_adjoint or self.prepared.seeds.count <= MOST_FORWARD
        for slopes in [self._by_adjoint] * self.by_adjoint + [self._forward] * is_short:
            try:
                return np.array(slopes(other)).reshape(unknown.shape)
            except (MbdkitError, NotByAdjointError, ArithmeticError):
                continue
        return unknown

    def _by_adjoint(self, other: RunSpec) -> list[np.ndarray]:
        other = with_sections(other, stabilization="none")  # with this tolerance, drift is small
        if why := why_forward(other, make_method(other), self.prepared.seeds):
            raise NotByAdjointError(why)
        run = AdjointRun(other, self.prepared.seeds, self.needs)
        return [one.slope for one in run.measures(self.expressions).values()]

    def _forward(self, other: RunSpec) -> list[np.ndarray]:
        seeds = self.prepared.seeds
        derived = derived_measures(differentiated_run(other, seeds, self.needs), self.expressions, seeds)
        return [one.slope for one in derived.values()]

    def _others(self, spec: RunSpec, interval: float | None) -> list[RunSpec]:
        return other_methods(RunSetup.of(spec), ASSUMED_STEPS, interval)


def measured_values(expressions: Mapping[str, MeasureExpression], spec: RunSpec) -> list[float]:
    """Return measures (M,) of a run in their units; an empty list if the run fails."""
    found = measured_in([expression.text for expression in expressions.values()], spec) or ()
    return [value / one.unit.factor for value, one in zip(found, expressions.values(), strict=False)]


def _recorded_interval(spec: RunSpec) -> float | None:
    """Return the interval of the recorded states of a run [s]; None if it depends on the step sizes."""
    if spec.output.interval is not None or spec.time.step is None:
        return spec.output.interval
    return spec.time.step * (spec.output.every or 1)
