"""Finds where a motion passes a state at which forces, rates, integrands or conditions jump.

The optimizer knows values and derivatives at collocation points only. If a force jumps between two of them, nothing
says how a change of the motion changes the time of the jump, however short the interval is. The solution is stationary
among the motions that pass the jump at this time, and may be far from an optimum. What remains of the equations between
the points does not show this, because it vanishes with the length of the interval.

Jumps are therefore searched for by the function itself. Along the polynomials of the solution, with controls and
multipliers held, each change between neighbouring samples is bisected until it is short compared with the distance of
the collocation points. A change that is still there is too fast for the derivatives at these points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.mechanism.values import curve_of
from mbdkit_predict.point_functions import ARGUMENTS, OF_POINTS, OF_STATE
from mbdkit_predict.transcription import Mesh, Transcription

SAMPLES = 10_000  #: Number of samples of a motion, besides the collocation points.
#: Half the time in which a change counts as a jump, as a share of the distance of the collocation points: hyperbolic
#: tangents whose argument changes by more than about 5 in this distance are found. And how often changes are bisected.
CLOSE, HALVINGS = 2.0**-6, 9
STEEPER = 1.5  #: How much steeper a jump is than its surroundings, at four to twelve times half the time.
#: Where intervals are bisected, so that symmetric functions such as x/abs(x) are rarely evaluated at their centre.
UNEQUAL = 0.49
#: By how much states are moved to see whether the jump moves: a multiple of their change around it.
MOVED = 16.0
#: Least size of forces relative to the largest, and of motions relative to their range: smaller ones are noise.
LEAST = 1e-6


class Jump(NamedTuple):
    """A jump of something that depends on the state."""

    time: float  #: When the motion passes it [s].
    half: float  #: Half the time within which it is known, or more [s].
    name: str  #: What jumps: the key path of an expression, or words; empty if no change of the motion moves the jump.


def jumps_along(method: Transcription, mesh: Mesh) -> list[Jump]:
    """Return the jumps that a solution passes."""
    path, least = MotionPath(method, mesh), math.sqrt(method.spec.tolerance)
    knots = np.unique(np.concatenate([[0.0], mesh.times, path.ends]))
    times = np.unique(np.concatenate([knots, np.linspace(0.0, knots[-1], SAMPLES + 1)]))
    between = np.array([times[:-1], times[1:]])
    held = between.mean(axis=0)
    values = np.array([path(side, held) for side in between])
    sizes = path.sizes(values)
    gaps = np.pad(np.diff(knots), 1, mode="edge")
    widest = np.max([gaps[:-2], gaps[1:-1], gaps[2:]], axis=0)[np.searchsorted(knots, held) - 1]

    def shares(change: np.ndarray) -> np.ndarray:
        """Return changes (R, K) as shares of the sizes; those of values that do not exist are infinite."""
        return np.asarray(np.nan_to_num(abs(change) / sizes, nan=np.inf))

    for _ in range(HALVINGS):
        keep = shares(values[1] - values[0]).max(axis=0, initial=0.0) > least
        if not keep.any():
            return []
        between, values, held, widest = between[:, keep], values[..., keep], held[keep], widest[keep]
        middle = between[0] + UNEQUAL * (between[1] - between[0])
        inside = path(middle, held)
        first, last = (shares(inside - side).max(axis=0, initial=0.0) for side in values)
        between = np.where(first > last, (between[0], middle), (middle, between[1]))
        values = np.where(first > last, (values[0], inside), (inside, values[1]))
    at, h = between.mean(axis=0), CLOSE * widest
    far, near, before, after = (
        path(at + k * h, held) - path(at + j * h, held) for j, k in ((-2, 2), (-1, 1), (-12, -4), (4, 12))
    )
    bend, outside = shares(2.0 * near - far), np.maximum(abs(before), abs(after))
    bend[abs(near) <= STEEPER * 0.25 * outside] = 0.0  # corners, whose slope is as large beside them
    jumps = list[Jump]()
    for k in np.flatnonzero(bend.max(axis=0, initial=0.0) > least).tolist():
        is_new, row = not jumps or at[k] - jumps[-1].time > 2.0 * h[k], int(bend[:, k].argmax())
        if is_new or not jumps[-1].name:
            name = path.name_of(at[k], h[k], row) if path.can_move(at[k], h[k], row) else ""
            jumps[len(jumps) if is_new else -1 :] = [Jump(float(at[k]), float(h[k]), name)]
    return jumps


class MotionPath:
    """Forces, rates, integrands and conditions, R rows, as functions of the state along a solution.

    Attributes
    ----------
    ends : (N,) array
        Ends of the intervals [s].
    given
        Symbols of the arguments of the functions of a collocation point.
    unknown
        Those of what is not known at the start and the end of a motion.
    """

    def __init__(self, method: Transcription, mesh: Mesh):
        self._method, self._mesh = method, mesh
        self.ends, self._lengths = (mesh.values["duration"] @ x for x in (mesh.grid.ends, mesh.grid.lengths))
        is_angle, states = method.system.is_angle, np.arange(len(mesh.values["z"]))
        self._kinds = np.concatenate([-1 - is_angle, -3 - is_angle, states])
        given = [*method.system.symbols.values(), ca.SX.sym("mu", len(mesh.values["mu"]))]
        results = method.functions.unheld(*given)
        self.given, self._rows = given, ca.Function("rows", given, [ca.vertcat(*(results[k] for k in (4, 2, 3, 5)))])
        self.unknown = [x for name, x in method.system.symbols.items() if name in OF_STATE] + given[-1:]
        self._ranges = self._of_kind(np.ptp(np.vstack([mesh.values[name] for name in "qvz"]), axis=1))

    def _of_kind(self, values: np.ndarray) -> np.ndarray:
        """Return the largest of values (2 n + Z,) of the same kind: positions, angles, their velocities, each state."""
        return np.array([values[self._kinds == kind].max() for kind in self._kinds])

    def _states(self, times: np.ndarray) -> np.ndarray:
        return np.vstack([self._at(name, times) for name in "qvz"])

    def _at(self, name: str, times: np.ndarray) -> np.ndarray:
        intervals = np.minimum(np.searchsorted(self.ends, times), len(self.ends) - 1)
        begins = (self.ends - self._lengths)[intervals]
        return self._method.values_at(self._mesh, name, (times - begins) / self._lengths[intervals], intervals)

    def __call__(self, times: np.ndarray, held: np.ndarray, moved: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the rows (R, K) at times (K,), without accelerations, with controls and multipliers at the times when
        they are `held`; states and times are `moved` by (2 n + Z + 1,).
        """
        return self._evaluated(self._rows, times, held, moved)

    def _evaluated(self, function: ca.Function, times: np.ndarray, held: np.ndarray, moved: Any = 0.0) -> np.ndarray:
        known = np.vstack([self._states(times), times]) + np.reshape(moved, (-1, 1))
        q, v, z, t = np.split(known, np.cumsum([*(len(self._mesh.values[name]) for name in "qvz")]))
        lam, mu, u = (self._at(name, held) for name in ("lam", "mu", "u"))
        p = np.tile(self._mesh.values["p"][:, None], len(times))
        return np.array(function.map(len(times))(q, v, 0.0 * v, lam, z, u, p, t, mu))

    def along(self, function: ca.Function, times: np.ndarray) -> np.ndarray:
        """Return the values (K, T) of a function of the arguments `given` at times (T,), as they are in the motion."""
        x = {name: self._at(name, times) for name in OF_POINTS}
        for name, table in self._method.spec.tables.items():
            x["u"][self._method.spec.chosen.control_states.index(f"measured.{name}")] = curve_of(table)(times)
        p = np.tile(self._mesh.values["p"][:, None], len(times))
        return np.array(function.map(len(times))(*(x[name] for name in ARGUMENTS), p, times[None], x["mu"]))

    def evaluate(self, expressions: Sequence[ca.SX], times: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return expressions (K,) of the arguments `given` at times (T,), as the rows are, (K, T)."""
        return self._evaluated(ca.Function("values", self.given, [ca.vertcat(*expressions)]), times, held)

    def sizes(self, values: np.ndarray) -> np.ndarray:
        """Return what counts as large in each row (R, 1): the largest of its values (2, R, K), and at least `LEAST` of
        all forces, or of the states by the duration.
        """
        sizes = np.nanmax(abs(values), axis=(0, 2), initial=0.0)
        n, z = len(self._mesh.values["q"]), self._mesh.values["z"]
        least = [*[sizes[:n].max(initial=0.0)] * n, *(abs(z).max(axis=1, initial=0.0) / self.ends[-1])]
        sizes[: len(least)] = np.maximum(sizes[: len(least)], LEAST * np.array(least))
        return np.where(sizes > 0.0, sizes, np.inf)[:, None]

    def can_move(self, at: float, h: float, row: int) -> bool:
        """Return whether the jump of a row at a time moves or vanishes if states and durations change in a way that the
        joints, and conditions at this time, permit.
        """
        method, grid = self._method, self._mesh.grid
        state, around = self._states(np.array([at])), self._states(at + h * np.array([-2.0, 2.0]))
        phase = int(grid.phase[min(int(np.searchsorted(self.ends, at)), len(grid.phase) - 1)])
        low, high, _ = method.limits["duration"][:, : phase + 1]
        move = self._of_kind(abs(around[:, 1] - around[:, 0])) + LEAST * self._ranges
        move = MOVED * np.append(move, 4.0 * h if (low < high).any() else 0.0)
        nodes = [0.0, *self.ends[grid.ends_of_phases()]]
        node = next((k for k, time in enumerate(nodes) if abs(at - time) <= 2.0 * h), None)
        slopes = method.slopes_of_conditions(state, self._mesh.values["p"], at, node) * move
        random = np.random.default_rng(0).standard_normal(len(move))
        random -= np.linalg.pinv(slopes, rcond=1e-9) @ (slopes @ random)
        times, held = at + h * np.array([-1.0, 1.0]), np.array([at, at])
        jump, *others = (np.ptp(self(times, held, side * move * random)[row]) for side in (0.0, 1.0, -1.0))
        return not min(others) > 0.5 * jump

    def name_of(self, at: float, h: float, row: int) -> str:
        """Return the key path of an expression that jumps, or words for what jumps in a row."""
        method, system = self._method, self._method.system
        mechanism = system.chosen.mechanism
        for key, text in [*mechanism.expressions(), *mechanism.motions()]:
            if not isinstance(text, str):
                continue
            try:
                function = ca.Function("value", self.given, [system.expression(text)])
            except SpecError:  # such as an expression of a controller
                continue
            values = self._evaluated(function, at + h * np.array([-12.0, -4.0, -1.0, 1.0, 4.0, 12.0]), np.full(6, at))
            before, _, near, _, after = abs(np.diff(values))[0]
            if not near <= STEEPER * 0.25 * max(before, after):
                return f"`{key}`"
        names = [f"The force on '{system.bodies[k // 3]}'" for k in system.places]
        names += [f"The rate of '{name}'" for name in system.state_names]
        names += ["An integrand of `minimize`"] * method.objective.integrands.numel()
        return [*names, *method.path_names][row]
