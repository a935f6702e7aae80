"""Derivatives of the preparation of a run: of the compiled mechanism and of its consistent start, with respect to
parameters.

The preparation validates the model, builds and compiles the mechanism, and assembles its initial state. The numbers in
expressions of measures and events may depend on named parameters, and are differentiated in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from mbdkit.plugin import RunSpec, SpecError
from mbdkit.plugin.equations import CompiledMechanism, Starts, with_ground
from mbdkit.plugin.files import Path
from mbdkit.plugin.runs import GivenStart, knots_of
from mbdkit.plugin.specs import VariedSpecs
from mbdkit_gradients.differentiated_expressions import NO_MEASURES, Definitions, numbers_of, numbers_of_events
from mbdkit_gradients.gradient_parameters import Parameter
from mbdkit_gradients.parameter_differences import (
    CENTRAL,
    ArrayDerivatives,
    Arrays,
    Preparation,
    PreparedDerivatives,
    weights,
)

VariedMechanisms = dict[tuple[Path, float, tuple[tuple[Path, float], ...]], tuple[tuple[RunSpec, GivenStart], Arrays]]
"""Mechanisms by changed parameter, its value and the values of all parameters: the spec with what finds its states, and
the numbers of expressions."""
POSITION, VELOCITY = "position equations", "velocity equations"
"""Names of the residuals of the equations of a start with given values."""
NUDGE = 0.0125
"""Largest change of a coordinate [m, rad] by which the derivatives of matrices are differences of order 8."""
RANK = 1e-9
"""Smallest singular value, relative to the largest, of matrices that count as regular."""


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
    varied
        Mechanisms with other values of parameters, which are added. Preparations of specs that differ only in the times
        and in `inputs` may share them.
    """

    ROUNDED = ("q", "v")

    def __init__(
        self,
        spec: RunSpec,
        numbers: Callable[[RunSpec], Arrays],
        initial: Mapping[str, float] = MappingProxyType({}),
        specs: VariedSpecs | None = None,
        values: Mapping[Path, float] = MappingProxyType({}),
        varied: VariedMechanisms | None = None,
    ):
        self.spec, self.numbers, self.initial, self.values = spec, numbers, initial, values
        self.specs = VariedSpecs(spec.canonical_json()) if specs is None else specs
        self.varied = {} if varied is None else varied
        self.starts = Starts()
        self._given: tuple[RunSpec, GivenStart] | None = None
        self._equations: _StartEquations | None = None
        self.mechanism, self.base = self._arrays(spec, self._numbers(spec), initial)
        self.knots = knots_of(spec)

    def _arrays(
        self, spec: RunSpec, numbers: Arrays, initial: Mapping[str, float]
    ) -> tuple[CompiledMechanism, dict[str, np.ndarray]]:
        if initial:
            if self._given is None or self._given[0] is not spec:
                self._given = spec, GivenStart(spec.mechanism(), spec, self.starts)
            start = self._given[1].start
            if self._equations is not None:
                known = {
                    "q": self.base["q"],
                    "v": self.base["v"],
                    **self._equations.residuals(self._given[1]),
                    **numbers,
                }
                return start.mechanism, self.mechanism_arrays(start.mechanism) | known
            q, v = map(with_ground, self._given[1].state(initial))
        else:
            start = self.starts.at_start(spec.mechanism(), spec.time.start, spec.time.final)
            q, v = start.q0, start.v0
        return start.mechanism, {**self.mechanism_arrays(start.mechanism), "q": q, "v": v, **numbers}

    def _numbers(self, spec: RunSpec) -> Arrays:
        """Return the numbers of expressions, if the spec has parameters on which they may depend."""
        return self.numbers(spec) if spec.parameters else {}

    def derivatives(self, parameters: Sequence[Parameter]) -> PreparedDerivatives:
        """Return the derivatives of the arrays with respect to parameters; see `Preparation.derivatives`."""
        if self._given is not None:
            equations = _StartEquations(self._given[1], self.initial, self.base["q"][:-3], self.base["v"][:-3])
            if equations.determine_the_start:
                self._equations, self.base = equations, {**self.base, **equations.residuals(self._given[1])}
        return super().derivatives(parameters)

    def _by(self, parameter: Parameter) -> ArrayDerivatives:
        if self._equations is None:
            return super()._by(parameter)
        is_initial = parameter.path[0] == "initial"
        found = ArrayDerivatives({}, 0.0, 0) if is_initial else super()._by(parameter)
        residuals = self._equations.by_value(str(parameter.path[1])) if is_initial else found.slopes
        others = {name: slope for name, slope in found.slopes.items() if name not in (POSITION, VELOCITY)}
        return replace(found, slopes=others | self._equations.slopes(residuals))

    def at(self, parameter: Parameter, value: float) -> Arrays:
        """Return the arrays for another value of a parameter; see `Preparation.at`."""
        if parameter.path[0] == "initial":
            changed = {**self.initial, str(parameter.path[1]): value}
            return self._arrays(self.spec, {name: self.base[name] for name in self._numbers(self.spec)}, changed)[1]
        key = parameter.path, value, tuple(self.values.items())
        if self._equations is not None and key in self.varied:
            self._given, numbers = self.varied[key]
            return self._arrays(self._given[0], numbers, self.initial)[1]
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
        if self._given is not None and not spec.mechanism().motions():  # joints do not depend on the time
            self.varied[key] = self._given, numbers
        return arrays


@dataclass(frozen=True)
class _StartEquations:
    """The equations that determine a start with given values, differentiated as implicit functions.

    Their residuals at a fixed state are mostly linear in the parameters, so that few mechanisms need to be built; the
    state itself is not.

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
    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (R, n) of the residuals with respect to positions, and to velocities."""
        (_, of_positions), (_, of_velocities) = self.given.equations(self.initial, self.q, self.v)
        return of_positions, of_velocities

    @property
    def determine_the_start(self) -> bool:
        """Whether the equations have a single solution, which does not depend on where the search for it begins."""
        is_free = len(self.given.search.free) == self.given.n
        return is_free and all(np.linalg.matrix_rank(x * self.given.light, RANK) == len(self.q) for x in self.matrices)

    def residuals(self, given: GivenStart) -> dict[str, np.ndarray]:
        """Return the residuals for another mechanism at the same state, plus a constant of the size of their terms, to
        which rounding errors are relative.
        """
        (position, _), (velocity, _) = given.equations(self.initial, self.q, self.v)
        length = self.given.length
        return {POSITION: position + length, VELOCITY: velocity + max(length, float(np.max(np.abs(self.v))))}

    def by_value(self, name: str) -> dict[str, np.ndarray]:
        """Return the derivatives of the residuals with respect to one of the given values, in which they are linear."""
        changed = {**self.initial, name: self.initial[name] + 1.0}
        (position, _), (velocity, _) = self.given.equations(changed, self.q, self.v)
        (position_now, _), (velocity_now, _) = self.given.equations(self.initial, self.q, self.v)
        return {POSITION: position - position_now, VELOCITY: velocity - velocity_now}

    def slopes(self, residuals: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the derivatives of the start, ``q`` and ``v``, given those of the residuals at a fixed state."""
        light, (of_positions, of_velocities) = self.given.light, self.matrices
        dq = np.zeros(len(self.q))
        change = residuals.get(VELOCITY, np.zeros(len(of_velocities)))
        if POSITION in residuals:
            dq = -light * np.linalg.lstsq(of_positions * light, residuals[POSITION], RANK)[0]
            unit = NUDGE / max(float(np.max(np.abs(dq))), 1e-300)
            now = self._velocity_residual(0.0 * dq)
            for place, weight in zip(CENTRAL, weights(CENTRAL), strict=True):
                change = change + weight * (self._velocity_residual(place * unit * dq) - now) / unit
        dv = -light * np.linalg.lstsq(of_velocities * light, change, RANK)[0]
        return {"q": with_ground(dq), "v": with_ground(dv)}

    def _velocity_residual(self, change: np.ndarray) -> np.ndarray:
        return self.given.equations(self.initial, self.q + change, self.v)[1][0]
