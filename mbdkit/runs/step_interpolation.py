"""States between the steps of a run, by Hermite interpolation over several steps.

Dense output of an explicit method of order 8 takes three more evaluations in each step, but positions, velocities and
accelerations at the ends of steps are known at no cost. Four ends define a polynomial of degree 11, whose error is far
below that of the steps (1e-5 of it for steps of an eighth of a period).
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.frozen import dataclass
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.interface import SAME_TIME

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

NODES = 4  #: Number of step ends that determine one polynomial; fewer next to a discontinuity of a motion.
#: Number of step ends that determine one polynomial if accelerations are not used; its degree is also 11.
NODES_WITHOUT_ACCELERATIONS = 6
#: Smallest distance between two ends used by a polynomial, as a share of the step for which it is computed.
#:
#: The two ends of the step itself are always used. Rounding errors grow with the inverse of this share to the power of
#: five. At a share of 1e-4, as for a last step that is cut by an event, they reach 1e-6 of the accelerations; at 1e-7,
#: no digit is right.
LEAST_DISTANCE = 0.05

FEW = 16  #: Largest number of steps in a call whose polynomials are kept.
MOST_KEPT = 2**22  #: Largest number of coefficients that are kept (32 MB).


@dataclass(frozen=True, eq=False)
class StepEnds:
    """States at the ends of all steps of a run, or of a part of it between two discontinuities of motions.

    - `time`: (N,) times [s].
    - `q`, `v`, `a`: (N, 3 (B + 1)) positions, velocities and accelerations. If `a` is None, accelerations are not used,
      because in stiff mechanisms they amplify the errors of positions. All three arrays may have an additional last
      axis of derivatives.
    - `held`: (N, Z) forces that the method sets, which have no rates; None without them.
    - `is_linear`: whether all states are linear over each step, as in time-stepping methods, whose steps contain
      impacts: polynomials of a higher degree would overshoot there.
    """

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray | None
    held: np.ndarray | None = None
    is_linear: bool = False

    def held_at(self, times: np.ndarray) -> np.ndarray:
        """Return the forces that the method sets at times (T,) [s]: (T, Z).

        Between two events, at which steps end, they are splines through the ends of the steps.
        """
        held = np.zeros((len(self.time), 0)) if self.held is None else self.held
        if self.is_linear or not held.shape[1]:
            return self._linear(times, held)
        return np.asarray(self._spline(times))

    @cached_property
    def _spline(self) -> BSpline:
        """The spline of degree 5, or less with few ends, through the forces at ends that are not too close."""
        from scipy.interpolate import make_interp_spline  # most runs do not need it

        assert self.held is not None
        least, used = LEAST_DISTANCE * float(np.median(np.diff(self.time))), [0]
        for end in range(1, len(self.time)):
            is_close = self.time[end] - self.time[used[-1]] < least
            if end == len(self.time) - 1 and is_close and len(used) > 1:
                used.pop()
            if end == len(self.time) - 1 or not is_close:
                used.append(end)
        return make_interp_spline(self.time[used], self.held[used], k=min(5, len(used) - 1))

    def _linear(self, times: np.ndarray, values: np.ndarray) -> np.ndarray:
        columns = [np.interp(times, self.time, column) for column in values.T]
        return np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities at times (T,) from the first to the last end [s], in order."""
        if self.is_linear:
            return self._linear(times, self.q), self._linear(times, self.v)
        step = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 2)
        used, index = np.unique(step, return_inverse=True)
        nodes, newton = self._newton(used)
        h = self.time[used + 1] - self.time[used]
        s = (times - self.time[step]) / h[index]
        more = (slice(None), *(None,) * (self.q.ndim - 1))
        value, slope = np.zeros((2, len(times), *self.q.shape[1:]))
        for k in reversed(range(len(newton))):
            along = (s - nodes[k, index])[more]
            slope = slope * along + value
            value = value * along + newton[k, index]
        return value, slope / h[index][more]

    def _newton(self, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return nodes (K, S) and coefficients (K, S, n) of the Newton form over each step, in units of the step.

        Those of few steps are kept, because roots and extrema of several measures are refined by many evaluations in
        the same steps.
        """
        if len(steps) > FEW:
            return self._new_newton(steps)
        numbers = steps.tolist()
        if missing := [number for number in numbers if number not in self._kept]:
            nodes, newton = self._new_newton(np.array(missing))
            if (len(self._kept) + len(missing)) * newton[:, 0].size > MOST_KEPT:
                self._kept.clear()
                missing, (nodes, newton) = numbers, self._new_newton(steps)
            self._kept.update((number, (nodes[:, k], newton[:, k])) for k, number in enumerate(missing))
        kept = [self._kept[number] for number in numbers]
        return np.stack([nodes for nodes, _ in kept], axis=1), np.stack([newton for _, newton in kept], axis=1)

    @cached_property
    def _kept(self) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Nodes (K,) and coefficients (K, n) of the Newton forms over steps."""
        return {}

    def _new_newton(self, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count = min(NODES if self.a is not None else NODES_WITHOUT_ACCELERATIONS, len(self.time))
        first = np.clip(steps - (count - 2) // 2, 0, len(self.time) - count)
        window = first + np.arange(count)[:, None]  # (NODES, S)
        gaps = np.where(window[:-1] == steps, np.inf, np.diff(self.time[window], axis=0))
        close = np.min(gaps, axis=0, initial=np.inf) < LEAST_DISTANCE * (self.time[steps + 1] - self.time[steps])
        nodes, newton = self._divided_differences(steps, window)
        for index in np.flatnonzero(close):
            piece = steps[index : index + 1]
            own = self._divided_differences(piece, self._apart(int(piece[0]), count)[:, None])
            for every, values in zip((nodes, newton), own, strict=True):
                every[:, index] = 0.0  # coefficients of higher powers
                every[: len(values), index] = values[:, 0]
        return nodes, newton

    def _apart(self, step: int, count: int) -> np.ndarray:
        """Return the ends of a step, and up to `count` - 2 others near it that are not too close to each other."""
        time = self.time
        least = LEAST_DISTANCE * (time[step + 1] - time[step])
        sides: list[list[int]] = []
        for begin, places in ((step, range(step - 1, -1, -1)), (step + 1, range(step + 2, len(time)))):
            columns = [begin]
            for end in places:
                if abs(time[end] - time[columns[-1]]) >= least:
                    columns.append(end)
                if len(columns) == count:
                    break
            sides.append(columns[1:])
        before, after = sides
        left = min((count - 2) // 2, len(before))
        right = min(count - 2 - left, len(after))
        left = min(count - 2 - right, len(before))
        return np.array(sorted([*before[:left], step, step + 1, *after[:right]]))

    def _divided_differences(self, steps: np.ndarray, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return nodes (K, S) and coefficients (K, S, n) of the Newton form on the ends in `window` (NODES, S).

        Every node occurs three times in the divided differences, or twice without accelerations; the two ends of the
        step come first.
        """
        is_end = (window == steps) | (window == steps + 1)
        window = np.take_along_axis(window, np.argsort(~is_end, axis=0, kind="stable"), axis=0)
        order = np.repeat(window, 2 if self.a is None else 3, axis=0)
        more = (..., *(None,) * (self.q.ndim - 1))
        h = self.time[steps + 1] - self.time[steps]
        nodes = (self.time[order] - self.time[steps]) / h
        rate = self.v[order] * h[more]
        curvature = None if self.a is None else self.a[order] * (h**2)[more] / 2
        column = self.q[order]
        newton = [column[0]]
        for level in range(1, len(order)):
            same = (order[level:] == order[:-level])[more]
            with np.errstate(divide="ignore", invalid="ignore"):
                slopes = (column[1:] - column[:-1]) / (nodes[level:] - nodes[:-level])[more]
            repeated = rate if level == 1 or curvature is None else curvature
            column = np.where(same, repeated[: len(slopes)], slopes)
            newton.append(column[0])
        return nodes, np.array(newton)


class StepStates:
    """The states of a run at any time, from the ends of its steps.

    `workspace`: workspace of the mechanism. `time`, `q`, `v`: (N,) times [s], and (N, 3 (B + 1)) positions and
    velocities at the start and the ends of all steps. `stops`, `margins`: times of discontinuities of motions and
    loads, at which steps end [s], and their margins; see `Timetable`.
    """

    def __init__(
        self,
        workspace: Workspace,
        time: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        stops: tuple[float, ...] = (),
        margins: tuple[float, ...] = (),
    ):
        self.time, self.width = time, q.shape[1]
        cuts: dict[int, tuple[float, float]] = {}
        for stop, margin in zip(stops, margins, strict=True):
            if time[0] < stop < time[-1]:
                cuts[int(np.searchsorted(time, stop - SAME_TIME * margin))] = stop - margin, stop + margin
        borders = sorted({0, *cuts, len(time) - 1})
        observer = StateObserver(workspace.with_own_pivots())
        self.parts: list[StepEnds] = []
        for begin, end in pairwise(borders):
            part = slice(begin, end + 1)
            seen = time[part].copy()  # accelerations may be discontinuous at stops, so they are evaluated beside them
            seen[0], seen[-1] = cuts[begin][1] if begin in cuts else seen[0], cuts[end][0] if end in cuts else seen[-1]
            out = observer.arrays(len(seen))
            ends = np.ascontiguousarray(q[part]), np.ascontiguousarray(v[part])
            singular = observer.observe(seen, *ends, out)
            known = len(seen) if singular is None else singular.row
            if known >= 2:
                whole = time[part], q[part], v[part], out.acc
                known_time, known_q, known_v, known_a = (x[:known] for x in whole)
                self.parts.append(StepEnds(known_time, known_q, known_v, known_a))
            if singular is not None:
                break

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities at times (T,) [s], in order; nan at times for which no states are known."""
        q, v = np.full((2, len(times), self.width), np.nan)
        begin = 0
        for part in self.parts:
            end = int(np.searchsorted(times, part.time[-1] + 1e-15 * abs(part.time[-1]), side="right"))
            if end > begin:
                q[begin:end], v[begin:end] = part.at(np.clip(times[begin:end], part.time[0], part.time[-1]))
            begin = max(begin, end)
        return q, v
