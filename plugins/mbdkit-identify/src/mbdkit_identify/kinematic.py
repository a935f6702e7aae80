"""Kinematic identification: each sample is an assembled position, with unknown independent coordinates of its own."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from mbdkit.plugin import RunSpec, SpecError
from mbdkit.plugin.runs import GivenStart
from mbdkit.plugin.studies import prepare
from mbdkit_identify.measured_data import RATES, plain_name

CHANGE = 1e-6  #: Relative change of a parameter in the differences of the residuals of joints.
TRACKING = 5  #: Number of Gauss-Newton steps by which the coordinates of a sample are guessed.


class _Sample(NamedTuple):
    """A position: the S quantities, and their derivatives with respect to K parameters and D coordinates (S, K + D)."""

    values: np.ndarray
    slopes: np.ndarray


class _Moved(NamedTuple):
    """The mechanism with a larger and a smaller value of one parameter, which differ from its value by `change`."""

    more: GivenStart
    less: GivenStart
    change: float


class _Evaluated(NamedTuple):
    """Quantities (S, T), and their derivatives (S, T, K + T*D)."""

    values: np.ndarray
    derivatives: np.ndarray


class Positions:
    """Evaluates S quantities at T positions of a mechanism, each given by its D independent coordinates.

    Raises
    ------
    SpecError
        If a quantity is no coordinate, or the mechanism is driven.
    """

    differences = ""

    def __init__(self, spec: RunSpec, quantities: Sequence[str], count: int, parameters: Sequence[str]):
        self._spec, self._parameters = prepare(spec), tuple(parameters)
        given = GivenStart(spec.mechanism(), spec)
        self._observed = [plain_name(quantity) for quantity in quantities]
        for quantity in self._observed:
            if quantity.rpartition(".")[2] in RATES.values():
                raise SpecError(f"'{quantity}' is a velocity, but `kinematic` uses positions only", key="observed")
        with SpecError.rekey("observed"):
            _, (driven, _) = given.equations(
                dict.fromkeys(self._observed, 0.0), given.start.q0[: given.n], np.zeros(given.n)
            )
        if np.any(driven):
            message = "the base has a driver, but `kinematic` estimates the position of each sample: remove the driver"
            raise SpecError(message, key="observed")
        bodies = [f"{body}.{axis}" for axis in ("angle", "x", "y") for body in spec.mechanism().bodies]
        self.independent = given.independent(dict.fromkeys([*self._observed, *bodies]))
        self._names = dict.fromkeys([*self._observed, *self.independent], 0.0)
        self.first = np.array([given.value(name) for name in self.independent])
        self._near: list[np.ndarray | None] = [None] * count

    def values(self, plain: Mapping[str, float], start: Mapping[str, float]) -> np.ndarray:
        """Return the quantities (S, T); nan where the mechanism cannot be assembled."""
        return np.array([sample.values for sample in self._samples(plain, start, ())]).T

    def at(self, plain: Mapping[str, float], start: Mapping[str, float]) -> _Evaluated:
        """Return the quantities and their derivatives with respect to the parameters and all coordinates."""
        samples = list(self._samples(plain, start, self._parameters))
        own, size = len(self._parameters), len(self.independent)
        slopes = np.zeros((len(self._observed), len(samples), own + len(start)))
        for row, sample in enumerate(samples):
            slopes[:, row, :own] = sample.slopes[:, :own]
            slopes[:, row, own + size * row : own + size * (row + 1)] = sample.slopes[:, own:]
        return _Evaluated(np.array([sample.values for sample in samples]).T, slopes)

    def tracked(self, plain: Mapping[str, float], targets: np.ndarray) -> np.ndarray:
        """Return coordinates (T, D) with which the quantities come close to `targets` (S, T), one after the other."""
        given, here, found = self._mechanism(plain), self.first, []
        for row, target in enumerate(targets.T):
            known = np.isfinite(target)
            with suppress(SpecError):  # the position before remains
                for _ in range(TRACKING):
                    sample = self._sample(given, (), row, here)
                    lack = (target - sample.values)[known]
                    here = here + np.linalg.lstsq(sample.slopes[known], lack, rcond=1e-9)[0]
            if self._near[row] is not None and row + 1 < len(self._near):
                self._near[row + 1] = self._near[row]
            found.append(here)
        return np.array(found)

    def _mechanism(self, plain: Mapping[str, float]) -> GivenStart:
        spec = self._spec.spec_with(plain) if plain else self._spec.spec
        return GivenStart(spec.mechanism(), spec)

    def _samples(
        self, plain: Mapping[str, float], start: Mapping[str, float], parameters: Sequence[str]
    ) -> Iterator[_Sample]:
        given, moved = self._mechanism(plain), list[_Moved]()
        for name in parameters:
            change = CHANGE * max(abs(plain[name]), CHANGE)
            more, less = (self._mechanism({**plain, name: plain[name] + side * change}) for side in (1.0, -1.0))
            moved.append(_Moved(more, less, change))
        for row, own in enumerate(np.reshape([*start.values()], (len(self._near), len(self.independent)))):
            try:
                yield self._sample(given, moved, row, own)
            except SpecError:
                failed = np.full(len(self._observed), np.nan)
                yield _Sample(failed, np.zeros((len(failed), len(parameters) + len(own))))

    def _sample(self, given: GivenStart, moved: Sequence[_Moved], row: int, coordinates: np.ndarray) -> _Sample:
        """Return the quantities of one sample, with derivatives by the parameters that are `moved`."""
        q = given.positions(dict(zip(self.independent, coordinates.tolist(), strict=True)), self._near[row])
        self._near[row] = q
        values, matrix = given.position_equations(self._names, q)
        by_parameter = np.zeros((len(values), len(moved)))
        for column, one in enumerate(moved):
            more, less = (side.position_equations(self._names, q)[0] for side in (one.more, one.less))
            by_parameter[:, column] = (more - less) / (2.0 * one.change)
        joints, names = len(values) - len(self._names), [*self._names]
        held = [*range(joints), *(joints + names.index(name) for name in self.independent)]
        shown = [joints + names.index(name) for name in self._observed]
        aim = np.zeros((len(held), len(coordinates)))
        aim[joints:] = np.eye(len(coordinates))
        moves = np.linalg.pinv(matrix[held]) @ np.column_stack([-by_parameter[held], aim])
        slopes = matrix[shown] @ moves
        slopes[:, : len(moved)] += by_parameter[shown]
        return _Sample(values[shown], slopes)
