"""Checks whether the force laws of a run are used within the ranges that they declare.

Length and rate of every pathway are evaluated at the ends of all steps, recorded or not. With implicit methods they are
evaluated at the stages instead if not every step is recorded. Between these times, the cubic polynomials through
lengths and rates are checked at their extremes. An excursion within a step is therefore found if the step resolves the
motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbdkit.archive.checkpoint import StoredState
from mbdkit.base.frozen import dataclass
from mbdkit.engine.compile_forces import acting_kinds
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.stored_arrays import fill
from mbdkit.integrators.interface import Failure, Nodes
from mbdkit.mechanism.element_kinds import forces_of
from mbdkit.mechanism.force_law import ARGUMENTS, law_range
from mbdkit.mechanism.law_element import Law
from mbdkit.trust.finding import Finding

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.workspace import Workspace
    from mbdkit.mechanism.mechanism import Mechanism
    from mbdkit.spec import RunSpec

ROUNDING = 1e-9  #: An argument may exceed a bound by this share of the bound with the larger magnitude.

#: Limit for extremes of a length or rate within a step, which are found by interpolation.
#:
#: An extreme counts as outside of a bound only if it exceeds the bound by more than this share of its difference from
#: the values at the ends of the step, of which the closer value counts. A smaller excess may be an error of the cubic
#: interpolation, which is of order 4 in the step.
BULGE = 0.02

UNBOUNDED = ((-math.inf, math.inf),) * len(ARGUMENTS)  #: Bounds of a law that holds everywhere.


def steps_are_rows(spec: RunSpec) -> bool:
    """Return whether the end of every step of a run is recorded."""
    return spec.output.interval is None and (spec.output.every or 1) == 1


@dataclass(frozen=True)
class WatchedLaw:
    """A force element whose law holds only for a range of values of its arguments: length, rate and time.

    `name`, `law`: kind and name of the element, and full name of its law. `column`: index of the element among all
    force elements. `unit`: unit of the length of the element. `bounds`: lowest and highest length, rate and time for
    which the law holds.
    """

    name: str
    law: str
    column: int
    unit: str
    bounds: tuple[tuple[float, float], ...]

    def held(self, argument: int) -> str:
        """Return a clause that says for which values of an argument the law holds."""
        (low, high), unit = self.bounds[argument], self.units[argument]
        if math.isinf(low):
            return f"its law {self.law} holds, up to {high:.6g} {unit}"
        end = "on" if math.isinf(high) else f"to {high:.6g} {unit}"
        return f"its law {self.law} holds, from {low:.6g} {unit} {end}"

    @property
    def units(self) -> tuple[str, str, str]:
        """Units of length, rate and time."""
        return self.unit, f"{self.unit}/s", "s"


def has_ranges(mechanism: Mechanism) -> bool:
    """Return whether any force law of a mechanism declares a range. Raises the errors of `law_range`."""
    laws: list[Any] = [force for force in mechanism.forces.values() if isinstance(force, Law)]
    for kind in acting_kinds(mechanism):
        laws += forces_of(kind, mechanism.elements[kind.key_in_model]).values()
    return any(_bounds(force) != UNBOUNDED for force in laws)


def _bounds(force: Any) -> tuple[tuple[float, float], ...]:
    return tuple(law_range(force.force_law, force, force.law_id).values())


class LawRanges:
    """How far the arguments of K force laws have left their ranges, over the states of a run in order of time.

    `laws`: the force elements that are checked. `workspace`: the mechanism, which is needed to evaluate states between
    the recorded ones; None if every step is recorded. `stops`: whether the run stops where a law leaves its range.
    """

    def __init__(self, laws: Sequence[WatchedLaw], workspace: Workspace | None = None, *, stops: bool = False):
        self.laws, self.stops = laws, stops
        self._columns = [law.column for law in laws]
        self._observer = None if workspace is None else StateObserver(workspace.with_own_pivots())
        self._between: list[np.ndarray] = []
        bounds = np.array([law.bounds for law in laws])  # (K, 3, 2)
        self._sides = np.array([-1.0, 1.0])
        finite = np.where(np.isfinite(bounds), np.abs(bounds), 0.0)
        self._limits = self._sides * bounds + ROUNDING * finite.max(axis=2, keepdims=True)
        self._first = np.full(bounds.shape, np.inf)
        self._worst = np.full(bounds.shape, -np.inf)
        self._worst_time = np.full(bounds.shape, np.nan)
        self._last = np.zeros((0, len(laws), 3))

    @classmethod
    def of(
        cls, model: Mechanism, mechanism: CompiledMechanism, workspace: Workspace | None = None, *, stops: bool = False
    ) -> LawRanges | None:
        """Return the `LawRanges` of a mechanism; None if none of its laws declares a range.

        Raises the errors of `has_ranges`.
        """
        if not has_ranges(model):
            return None
        laws = [
            WatchedLaw(
                f"{force.kind} '{force.name}'", force.force.law_id, force.place, force.force.pathway.length_unit, bounds
            )
            for force in mechanism.acting
            if (bounds := _bounds(force.force)) != UNBOUNDED
        ]
        return cls(laws, workspace, stops=stops)

    @property
    def needs_nodes(self) -> bool:
        """Whether states between the recorded ones are needed."""
        return self._observer is not None

    def add_between(self, nodes: Nodes) -> None:
        """Store states between recorded ones until `add` receives the next recorded states."""
        if self._observer is None or not len(nodes.time):
            return
        observed = self._observer.arrays(len(nodes.time))
        # The initial first-order states are sufficient, because lengths and rates do not depend on these states.
        z = np.tile(self._observer.workspace.mechanism.initial_states, (len(nodes.time), 1))
        time, q, v = map(np.ascontiguousarray, (nodes.time, nodes.q, nodes.v))
        singular = self._observer.observe(time, q, v, observed, z=z)
        known = slice(None if singular is None else singular.row)
        self._between.append(self._arguments(nodes.time[known], observed.forces[known]))

    def _arguments(self, time: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the arguments of the laws (T, K, 3) at times (T,), from the values of all force elements (T, F, 5)."""
        arguments = np.empty((len(time), len(self.laws), 3))
        arguments[..., :2], arguments[..., 2] = forces[:, self._columns, :2], time[:, None]
        return arguments

    def add(self, time: np.ndarray, forces: np.ndarray) -> float | None:
        """Check recorded states, and the states between them.

        `time`: (T,) times [s], later than those of earlier calls. `forces`: (T, F, 5) values of all force elements, of
        which the first two are length and rate. Returns time [s] at which the first law leaves its range; None if all
        states so far are within the ranges.
        """
        states = np.concatenate([self._last, *self._between, self._arguments(time, forces)])
        states, self._between = states[np.argsort(states[:, 0, 2], kind="stable")], []
        states = states[np.diff(states[:, 0, 2], prepend=-np.inf) > 0.0]
        self._last = states[-1:].copy()
        cubics = _cubics(states)
        values, times, margins = [states], [states[..., 2:]], [np.zeros_like(states)]
        for share in _turning_points(cubics):
            extremes = _values(cubics, share)
            values.append(extremes)
            times.append(states[:-1, :, 2:] + share * np.diff(states[..., 2:], axis=0))
            margins.append(BULGE * np.minimum(np.abs(extremes - states[:-1]), np.abs(extremes - states[1:])))
        every = np.concatenate(values)
        self._note(every, np.concatenate(margins), np.concatenate([x + 0.0 * every[:1] for x in times]), cubics)
        return None if np.all(np.isinf(self._first)) else float(self._first.min())

    def _note(self, values: np.ndarray, margins: np.ndarray, times: np.ndarray, cubics: np.ndarray) -> None:
        """Note the first and largest excess of the values (T, K, 3) over their bounds, where it exceeds `margins`."""
        for side, sign in enumerate(self._sides):
            outside = sign * values - margins > self._limits[..., side]
            for k, argument in zip(*np.nonzero(outside.any(axis=0)), strict=True):
                index, rows = (k, argument, side), np.flatnonzero(outside[:, k, argument])
                worst = rows[np.argmax(sign * values[rows, k, argument])]
                reached = sign * values[worst, k, argument]
                if reached > self._worst[index]:
                    self._worst[index], self._worst_time[index] = reached, times[worst, k, argument]
                if np.isinf(self._first[index]):
                    seen = float(times[rows, k, argument].min())
                    bound = self.laws[k].bounds[argument][side]
                    self._first[index] = _entry(cubics[:, :, k, 2], cubics[:, :, k, argument], bound, seen)

    def warnings(self) -> tuple[str, ...]:
        """Return one sentence for each bound that an argument of a law has exceeded."""
        warnings = []
        for k, argument, side in zip(*np.nonzero(np.isfinite(self._first)), strict=True):
            index = k, argument, side
            law, value = self.laws[k], self._sides[side] * self._worst[index]
            warnings.append(
                f"the {ARGUMENTS[argument]} of {law.name} leaves the range in which {law.held(int(argument))}, "
                f"at t = {self._first[index]:.6g} s, and reaches {value:.6g} {law.units[argument]} at "
                f"t = {self._worst_time[index]:.6g} s"
            )
        return tuple(warnings)

    def findings(self) -> tuple[Finding, ...]:
        """Return the doubts about bounds that were exceeded."""
        return tuple(Finding("law-ranges", "doubtful", warning, is_named=False) for warning in self.warnings())

    def failure(self) -> Failure:
        """Return the failure of a run that is stopped because a force law has left its range."""
        index = k, argument, _ = np.unravel_index(np.argmin(self._first), self._first.shape)
        law, what, first = self.laws[int(k)], ARGUMENTS[argument], float(self._first.min())
        leaves = f"the {what} of {law.name} leaves the range in which {law.held(int(argument))}"
        clause = self._outside(*map(int, index)) if self._worst_time[index] == first else leaves
        return Failure("out-of-range", f"at t = {first:.6g} s {clause}.")

    def in_one_state(self) -> tuple[str, ...]:
        """Return one clause for each argument that is out of range, with its value, if only one state was added."""
        return tuple(self._outside(*index) for index in np.argwhere(np.isfinite(self._first)).tolist())

    def _outside(self, k: int, argument: int, side: int) -> str:
        law, value = self.laws[k], self._sides[side] * self._worst[k, argument, side]
        return (
            f"the {ARGUMENTS[argument]} of {law.name} is {value:.6g} {law.units[argument]}, outside the range in which "
            f"{law.held(argument)}"
        )

    def stored(self) -> StoredState:
        """Return the state as plain values, for a checkpoint."""
        names = "first", "worst", "worst_time"
        return {name: getattr(self, f"_{name}") for name in names} | {"last": self._last, "between": self._between}

    def restore(self, state: StoredState) -> None:
        """Continue from a checkpoint; raise ValueError if its values are not valid for this run."""
        self._last = np.zeros((min(1, len(state["last"])), len(self.laws), 3))
        for name in ("first", "worst", "worst_time", "last"):
            fill(getattr(self, f"_{name}"), state[name])
        self._between = [np.zeros((len(values), len(self.laws), 3)) for values in state["between"]]
        for values, given in zip(self._between, state["between"], strict=True):
            fill(values, given)


def _cubics(states: np.ndarray) -> np.ndarray:
    """Return polynomials for length, rate and time between states (T, K, 3), as functions of the share of the step.

    The length is the cubic with the lengths and rates at both ends, and the rate its derivative. The coefficients (4, T
    - 1, K, 3) are ascending.
    """
    (s0, v0, t0), (s1, v1, _) = np.moveaxis(states[:-1], -1, 0), np.moveaxis(states[1:], -1, 0)
    h = states[1:, :, 2] - t0
    gap, zero = s1 - s0, np.zeros_like(s0)
    second, third = 3.0 * gap - h * (2.0 * v0 + v1), h * (v0 + v1) - 2.0 * gap
    length = np.stack([s0, h * v0, second, third])
    rate = np.stack([v0, 2.0 * second / h, 3.0 * third / h, zero])
    return np.stack([length, rate, np.stack([t0, h, zero, zero])], axis=-1)


def _values(cubics: np.ndarray, share: np.ndarray) -> np.ndarray:
    c0, c1, c2, c3 = cubics
    return np.asarray(c0 + share * (c1 + share * (c2 + share * c3)))


def _turning_points(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the two shares of each step at which a cubic has an extreme; 0 for extremes outside the step."""
    _, c1, c2, c3 = cubics
    with np.errstate(all="ignore"):
        sum_ = -(c2 + np.copysign(np.sqrt(c2 * c2 - 3.0 * c3 * c1), c2))
        roots = sum_ / (3.0 * c3), c1 / sum_
    first, second = (np.where((x > 0.0) & (x < 1.0), x, 0.0) for x in roots)
    return first, second


def _entry(times: np.ndarray, cubics: np.ndarray, bound: float, seen: float) -> float:
    """Return the time at which a value first passes a bound; `seen` is a time at which it is beyond the bound.

    Only the step that contains `seen` is searched. `times` and `cubics` are the coefficients (4, N) of time and value
    in each step.
    """
    step = int(np.searchsorted(times[0], seen)) - 1
    if step < 0:
        return seen
    start, h = times[:2, step]
    roots = np.roots((cubics[:, step] - [bound, 0.0, 0.0, 0.0])[::-1])
    shares = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real * h <= seen - start)]
    return float(start + h * shares.min()) if len(shares) else seen
