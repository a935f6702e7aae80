"""Derivatives of the preparation of a run: of the compiled mechanism and of its consistent start, with respect to
parameters.

The preparation validates the model, builds and compiles the mechanism, and assembles its initial state. The numbers in
expressions of measures and events may depend on named parameters, and are differentiated in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from mbdkit.plugin import RunSpec, SpecError
from mbdkit.plugin.equations import CompiledMechanism, Starts, with_ground
from mbdkit.plugin.files import Path
from mbdkit.plugin.runs import GivenStart, knots_of
from mbdkit.plugin.specs import VariedSpecs
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

    def numbers(spec: RunSpec) -> Arrays:
        return {**numbers_of(spec, definitions), **numbers_of_events(spec)}

    return RunPreparation(spec, numbers).derivatives(parameters)


class RunPreparation(Preparation):
    """Prepares runs of a spec with other values of a parameter.

    Parameters
    ----------
    spec
        The spec.
    numbers
        Function that returns the numbers of expressions that may depend on named parameters, by name of the array.
    initial
        Values of kinematic quantities at the start; see `mbdkit.PreparedRun.run`. The key path of a parameter that is
        one of them is ``("initial", NAME)``.
    specs, values
        What makes specs from the base of `spec`, and the values by key path with which it has made `spec`; by default,
        `spec` is the base.
    """

    ROUNDED = ("q", "v")

    def __init__(
        self,
        spec: RunSpec,
        numbers: Callable[[RunSpec], Arrays],
        initial: Mapping[str, float] = MappingProxyType({}),
        specs: VariedSpecs | None = None,
        values: Mapping[Path, float] = MappingProxyType({}),
    ):
        self.spec, self.numbers, self.initial, self.values = spec, numbers, initial, values
        self.specs = VariedSpecs(spec.canonical_json()) if specs is None else specs
        self.starts = Starts()
        self._given: tuple[RunSpec, GivenStart] | None = None
        self.mechanism, self.base = self._arrays(spec, self._numbers(spec), initial)
        self.knots = knots_of(spec)

    def _arrays(
        self, spec: RunSpec, numbers: Arrays, initial: Mapping[str, float]
    ) -> tuple[CompiledMechanism, dict[str, np.ndarray]]:
        if initial:
            if self._given is None or self._given[0] is not spec:
                self._given = spec, GivenStart(spec.mechanism(), spec, self.starts)
            start = self._given[1].start
            q, v = map(with_ground, self._given[1].state(initial))
        else:
            start = self.starts.at_start(spec.mechanism(), spec.time.start, spec.time.final)
            q, v = start.q0, start.v0
        return start.mechanism, {**self.mechanism_arrays(start.mechanism), "q": q, "v": v, **numbers}

    def _numbers(self, spec: RunSpec) -> Arrays:
        """Return the numbers of expressions, if the spec has parameters on which they may depend."""
        return self.numbers(spec) if spec.parameters else {}

    def at(self, parameter: Parameter, value: float) -> Arrays:
        """Return the arrays for another value of a parameter; see `Preparation.at`."""
        if parameter.path[0] == "initial":
            changed = {**self.initial, str(parameter.path[1]): value}
            return self._arrays(self.spec, {name: self.base[name] for name in self._numbers(self.spec)}, changed)[1]
        spec = self.specs.spec([*{**self.values, parameter.path: value}.items()])
        if knots_of(spec) != self.knots:
            raise SpecError(
                f"the time at which a motion, or its derivative, is discontinuous depends on '{parameter.name}'; "
                f"there are no derivatives with respect to such a parameter",
                key="gradients",
            )
        numbers = self._numbers(spec)
        self.require_same_form(numbers, parameter)
        mechanism, arrays = self._arrays(spec, numbers, self.initial)
        self.require_same_structure(mechanism, parameter, value)
        return arrays
