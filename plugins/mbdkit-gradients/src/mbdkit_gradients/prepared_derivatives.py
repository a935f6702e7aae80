"""Derivatives of the preparation of a run: of the compiled mechanism and of its consistent start, with respect to
parameters.

The preparation validates the model, builds and compiles the mechanism, and assembles its initial state. The numbers in
expressions of measures and events may depend on named parameters, and are differentiated in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbdkit.plugin import RunSpec, SpecError
from mbdkit.plugin.equations import CompiledMechanism, Starts
from mbdkit.plugin.specs import VariedSpecs
from mbdkit.runs.corners import knots_of
from mbdkit_gradients.differentiated_expressions import NO_MEASURES, Definitions, numbers_of, numbers_of_events
from mbdkit_gradients.gradient_parameters import Parameter
from mbdkit_gradients.parameter_differences import Arrays, Preparation, PreparedDerivatives


def prepared_derivatives(
    spec: RunSpec, parameters: Sequence[Parameter], definitions: Definitions = NO_MEASURES
) -> PreparedDerivatives:
    """Return the derivatives of a prepared run with respect to parameters: of the mechanism, and of its start ``q`` and
    ``v``.

    Parameters
    ----------
    definitions
        The measures, whose numbers may depend on the parameters.

    Raises
    ------
    SpecError
        If the structure of the mechanism depends on a parameter, or if the spec is not valid near its value.
    """
    return _RunPreparation(spec, definitions).derivatives(parameters)


class _RunPreparation(Preparation):
    """Prepares runs of a spec with other values of a parameter."""

    ROUNDED = ("q", "v")

    def __init__(self, spec: RunSpec, definitions: Definitions):
        self.definitions = definitions
        self.specs = VariedSpecs(spec.canonical_json())
        self.starts = Starts()
        self.mechanism, self.base = self._arrays(spec, self._numbers(spec))
        self.knots = knots_of(spec)

    def _arrays(self, spec: RunSpec, numbers: Arrays) -> tuple[CompiledMechanism, dict[str, np.ndarray]]:
        start = self.starts.at_start(spec.mechanism(), spec.time.start, spec.time.final)
        arrays = {**self.mechanism_arrays(start.mechanism), "q": start.q0, "v": start.v0}
        return start.mechanism, {**arrays, **numbers}

    def _numbers(self, spec: RunSpec) -> dict[str, np.ndarray]:
        """Return the numbers of measures and events, if the spec has parameters on which they may depend."""
        return {**numbers_of(spec, self.definitions), **numbers_of_events(spec)} if spec.parameters else {}

    def at(self, parameter: Parameter, value: float) -> Arrays:
        """Return the arrays for another value of a parameter; see `Preparation.at`."""
        spec = self.specs.spec([(parameter.path, value)])
        if knots_of(spec) != self.knots:
            raise SpecError(
                f"the time at which a motion, or its derivative, is discontinuous depends on '{parameter.name}'; "
                f"there are no derivatives with respect to such a parameter",
                key="gradients",
            )
        numbers = self._numbers(spec)
        self.require_same_form(numbers, parameter)
        mechanism, arrays = self._arrays(spec, numbers)
        self.require_same_structure(mechanism, parameter, value)
        return arrays
