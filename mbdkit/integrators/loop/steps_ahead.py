"""Several steps of a compiled method in one call of the step loop, some of which can be taken back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mbdkit.engine.kernels.bundle_types import RECORD, STATE, kept
from mbdkit.engine.kernels.system import OK
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.integrators.interface import ConsecutiveSteps, Stepper, Stretch
from mbdkit.integrators.loop import step_loop
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.run.step_path import new_path

#: Largest number of steps at once, and of coordinates in all of them; they take less than about 0.1 s.
MOST_STEPS, COORDINATES = 256, 20_000

MOST_BYTES = 1 << 23  #: Largest size of the buffer of states [bytes].


class StepsAhead:
    """Takes several steps at once, and keeps those before the first one that has to be examined in Python.

    To take steps back, the state before all of them is restored, and those to be kept are repeated, with the same bits.

    `stepper`: the stepper, started with ``Timetable.single``. `shares`: shares of each step, from 0 to 1, at which its
    states are wanted, in addition to those at its end. `most`: largest number of steps at once. `parts`: number of
    states of a step.
    """

    def __init__(self, stepper: CompiledStepper, shares: Sequence[float]):
        self.stepper, self.parts, self._shares = stepper, len(shares) + 1, np.array(shares)
        size, states = len(stepper.run_state.q), len(stepper.run_state.z)
        steps = max(stepper.pace.steps, min(MOST_STEPS, COORDINATES // size))
        self.most = max(1, min(steps, MOST_BYTES // (16 * self.parts * size)))
        by_method = tuple(shares) if stepper.has_dense_output else ()
        self._path: PinnedBundle = PinnedBundle(new_path(self.most, by_method, size, states))
        roles = STATE, RECORD
        arrays = *kept(stepper.run_state, *roles).values(), *stepper.kept_of_method(*roles).values()
        self._memory = *arrays, stepper.run_state.nodes
        self._before: list[np.ndarray] = []
        self._result = OK, 0

    @classmethod
    def of(cls, stepper: Stepper, shares: Sequence[float]) -> StepsAhead | None:
        """Return an object for a stepper; None if its steps must be taken one by one.

        These are steps that are taken in Python, steps that are differentiated, and those within which first-order
        states are known only right after the step.
        """
        if not isinstance(stepper, CompiledStepper) or not stepper.can_take_back:
            return None
        needs_rates = shares and len(stepper.run_state.z) and not stepper.has_dense_output
        stepper.method.pause_at_events()  # no velocity jumps between the steps of a call
        return None if needs_rates else cls(stepper, shares)

    @property
    def is_possible(self) -> bool:
        """Whether the next steps can be taken at once; not while the method extends its limit of iterations."""
        return not self.stepper.method.is_extended

    def take(self, steps: int) -> ConsecutiveSteps:
        """Take up to `steps` steps, none of them beyond a stop; `keep` must follow.

        Returns the state before the first step, and for each step those at the shares and at its end.
        """
        stepper, path = self.stepper, self._path.bundle
        stepper.begin_after_stop()
        stepper.method.serve()
        c = stepper.run_state
        self._before = [x.copy() for x in self._memory]
        begin = np.array([stepper.time]), c.q[None].copy(), c.v[None].copy(), c.z[None].copy()
        path.stored[0], self._result = 0, (OK, 0)
        if stepper.failure is None:
            self._result = stepper.drive(
                stepper.pinned_plan, min(steps, self.most, stepper.steps_left), self._path.address
            )
        count = int(path.stored[0])
        start = np.concatenate([begin[0], path.time[:count]])[:-1, None]
        size = path.time[:count, None] - start
        time = np.column_stack([start + self._shares * size, path.time[:count]])
        parts = [x[:count] for x in (path.q, path.v, path.z)]
        if len(path.shares) < len(self._shares):
            parts[:2] = self._interpolated(begin, parts, size[:, None])
        states = (x.reshape(count * self.parts, x.shape[2]) for x in parts)
        return ConsecutiveSteps(*map(np.concatenate, zip(begin, (time.ravel(), *states), strict=True)))

    def keep(self, count: int) -> Stretch:
        """Keep the first `count` of the steps taken, return to the state after them, and return their rows."""
        stepper, path = self.stepper, self._path.bundle
        status, rows = self._result
        ended = status in (step_loop.AT_STOP, step_loop.PAUSED)
        is_complete = (status == OK or ended) and not stepper.is_pending
        if count < path.stored[0] or not is_complete:  # a failed attempt is repeated, because its arrays were used
            for now, then in zip(self._memory, self._before, strict=True):
                now[...] = then
            status, rows = stepper.drive(stepper.pinned_plan, int(path.attempts[count - 1])) if count else (OK, 0)
            ended = status == step_loop.AT_STOP
        stepper.last_step = None
        stretch = stepper.collect(rows)
        if status == step_loop.PAUSED:
            stepper.method.resume()
        stepper.conclude(OK if ended else status)
        return stretch

    def _interpolated(
        self, begin: Sequence[np.ndarray], ends: Sequence[np.ndarray], h: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield positions and velocities (K, P, n) of the cubic Hermite interpolant of each step, and at its end.

        `ends` are positions, velocities and first-order states (K, 1, n) at the ends of the steps of size `h`
        (K, 1, 1). See `StepTaken.hermite`; first-order states are interpolated by dense output only.
        """
        s, (q1, v1, _) = self._shares[:, None], ends
        q0, v0 = (np.concatenate([x[None], y])[:-1] for x, y in zip(begin[1:3], (q1, v1), strict=True))
        b, c, d = h * v0, 3.0 * (q1 - q0) - h * (2.0 * v0 + v1), h * (v0 + v1) - 2.0 * (q1 - q0)
        yield np.concatenate([q0 + s * (b + s * (c + s * d)), q1], axis=1)
        yield np.concatenate([(b + s * (2.0 * c + 3.0 * s * d)) / h, v1], axis=1)
