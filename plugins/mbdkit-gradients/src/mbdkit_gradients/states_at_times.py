"""The states of a run at given times, with and without derivatives with respect to parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from mbdkit.base.errors import RunError, StepError
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.native.number_arrays import new_duals
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedStepper
from mbdkit.integrators.duals.dual_run import constants
from mbdkit.integrators.interface import Moment, Stepper, Stretch, joined
from mbdkit.integrators.run.sampled_control import states_at_start
from mbdkit.runs.step_interpolation import StepEnds
from mbdkit_gradients.differentiated_states import DifferentiatedStates, StateEvaluator, one_after_another
from mbdkit_gradients.sided_stepper import SidedStepper, sides_of, use_sides

Way = Literal["rows", "ends", "within"]

#: (C,) the sides of force laws, which are the same object as long as they do not change; None without such laws.
Sides = np.ndarray | None


class RunAtTimes:
    """The states of a run at given times, as arrays whose last axis has the value alone.

    Parameters
    ----------
    stepper, workspace
        The run at its start.
    way
        ``rows`` if the run records states at the times, ``ends`` if it records the ends of all steps, between which the
        motion is interpolated, or ``within`` if it takes single steps, which are repeated with smaller sizes.
    uses_accelerations
        Whether the interpolation uses accelerations; see `StepEnds`.
    """

    def __init__(self, stepper: Stepper, workspace: Workspace, way: Way, *, uses_accelerations: bool):
        self.stepper, self.workspace, self.way = stepper, workspace, way
        self._uses_accelerations, self._width = uses_accelerations, 1
        self._first = self._at_start()

    def states(self, times: np.ndarray, *, is_kinematic: bool) -> DifferentiatedStates:
        """Return the states at increasing times (T,) [s].

        Parameters
        ----------
        is_kinematic
            Whether no accelerations and forces are needed.

        Raises
        ------
        RunError
            If the run ends early.
        """
        times = self.stepper.timetable.before(times)  # type: ignore[attr-defined]
        moments, sides = self._within(times) if self.way == "within" else self._rows(times)
        self.workspace.clamp_motions(-np.inf, np.inf)
        changes = [k for k in range(1, len(times)) if sides[k] is not sides[k - 1]]
        parts = []
        for begin, end in zip([0, *changes], [*changes, len(times)], strict=True):
            q, v, z = (x[begin:end] for x in moments)
            parts.append(self._states(times[begin:end], q, v, z, sides[begin], is_kinematic=is_kinematic))
        return parts[0] if len(parts) == 1 else one_after_another(parts)

    def _advance(self) -> Stretch:
        try:
            stretch = self.stepper.advance()
        except StepError as error:
            raise RunError(str(error)) from None
        if self.stepper.failure is not None:
            raise RunError(f"{self.stepper.failure.code}: {self.stepper.failure.sentence}")
        return stretch

    def _rows(self, times: np.ndarray) -> tuple[Moment, Sequence[Sides]]:
        """Return the recorded states at the times, or the states between those."""
        stretches: list[Stretch] = []
        reached = self.workspace.t0
        while reached < times[-1] and not self.stepper.finished:
            stretches.append(self._advance())
            reached = stretches[-1].time[-1] if len(stretches[-1].time) else reached
        rows = np.concatenate([[self.workspace.t0], *(one.time for one in stretches)])
        q, v, z = (np.concatenate([a[None], b]) for a, b in zip(self._first, self._recorded(stretches), strict=True))
        if self.way == "ends":
            a = self._states(rows, q, v, z, None, is_kinematic=False).observed.acc if self._uses_accelerations else None
            # the run interpolates its values over several steps; that takes too long for all derivatives
            values = StepEnds(rows, q[..., 0], v[..., 0], None if a is None else a[..., 0]).at(times)
            if self._width == 1:
                q, v = (x[..., None] for x in values)
            else:
                q, v = over_single_steps(rows, q[..., : self._width], v[..., : self._width], a, times)
                q[..., 0], v[..., 0] = values
            return (q, v, z[: len(times)]), [None] * len(times)
        places = np.searchsorted(0.5 * (rows[1:] + rows[:-1]), times)
        return (q[places], v[places], z[places]), self._sides(places)

    def _within(self, times: np.ndarray) -> tuple[Moment, Sequence[Sides]]:
        """Return the states at times within steps."""
        at_start = int(np.searchsorted(times, self.workspace.t0, side="right"))
        found, sides = [self._first] * at_start, [sides_of(self.stepper)] * at_start
        while len(found) < len(times):
            self._advance()
            step, here = self.stepper.last_step, sides_of(self.stepper)
            while step is not None and len(found) < len(times):
                time = times[len(found)]
                if time > step.t1 and not self.stepper.finished:
                    break
                share = min(1.0, max(0.0, (time - step.t0) / (step.t1 - step.t0)))
                found.append(self._moment(share))
                sides.append(here)
        q, v, z = (np.stack([moment[k] for moment in found]) for k in range(3))
        return (q, v, z), sides

    # --- what differs with derivatives

    def _at_start(self) -> Moment:
        workspace = self.workspace
        return workspace.q0[:, None], workspace.v0[:, None], states_at_start(workspace)[:, None]

    def _recorded(self, stretches: Sequence[Stretch]) -> Moment:
        """Return the states that have been recorded after the start."""
        if not stretches:
            return tuple(np.empty((0, *x.shape)) for x in self._first)  # type: ignore[return-value]
        rows = joined(stretches)
        z = np.zeros((len(rows.time), 0)) if rows.z is None else rows.z
        return rows.q[..., None], rows.v[..., None], z[..., None]

    def _moment(self, share: float) -> Moment:
        """Return the state at a share of the last step."""
        q, v, z = self.stepper.within(share)
        return q[:, None], v[:, None], np.asarray(z)[:, None]

    def _sides(self, places: np.ndarray) -> Sequence[Sides]:
        """Return the sides at recorded states, counted from the start."""
        return [None] * len(places)

    def _states(
        self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray, sides: Sides, *, is_kinematic: bool
    ) -> DifferentiatedStates:
        def observe() -> Observed:
            observer = StateObserver(self.workspace.with_own_pivots())
            observed = observer.arrays(len(time))
            given = [np.ascontiguousarray(x[..., 0]) for x in (q, v, z)]
            if observer.observe(time, given[0], given[1], observed, z=given[2]) is not None:
                raise RunError("the accelerations at one of the times are not unique")
            return Observed(*(x[..., None] for x in observed))

        return DifferentiatedStates(self.workspace.mechanism, time, q, v, observe, z=z)


class DifferentiatedRunAtTimes(RunAtTimes):
    """The states of a run at given times, with derivatives with respect to up to `DIRECTIONS` parameters.

    Parameters
    ----------
    count
        Number of parameters.
    """

    stepper: DifferentiatedStepper

    def __init__(self, stepper: DifferentiatedStepper, count: int, way: Way, *, uses_accelerations: bool):
        super().__init__(stepper, stepper.workspace, way, uses_accelerations=uses_accelerations)
        self._evaluator, self._width = StateEvaluator(stepper.steps, count), 1 + count

    def _at_start(self) -> Moment:
        run = self.stepper.steps.run
        return np.array(run.q), np.array(run.v), np.array(self.stepper.z0)

    def _recorded(self, stretches: Sequence[Stretch]) -> Moment:
        q, v, z, _ = self.stepper.steps.recorded(self.stepper.recorded)
        return q, v, z

    def _moment(self, share: float) -> Moment:
        return self.stepper.derivatives_within(share)

    def _sides(self, places: np.ndarray) -> Sequence[Sides]:
        if not isinstance(self.stepper, SidedStepper):
            return super()._sides(places)
        history = self.stepper.history
        begins = [one.rows + 1 for one in history[1:]]
        return [history[k].sides for k in np.searchsorted(begins, places, side="right")]

    def _states(
        self, time: np.ndarray, q: np.ndarray, v: np.ndarray, z: np.ndarray, sides: Sides, *, is_kinematic: bool
    ) -> DifferentiatedStates:
        def observe() -> Observed:
            use_sides(self.stepper, sides)
            # kernels evaluate states with equal first-order states together, on which motion alone does not depend
            states = new_duals(len(time), 0) if is_kinematic else z
            own_q, own_v = (constants(x[..., 0], x[..., 1:]) for x in (q, v))
            return self._evaluator.states(time, own_q, own_v, states).observed

        given = (np.asarray(x)[..., : self._width] for x in (q, v, z))
        return DifferentiatedStates(self.workspace.mechanism, time, next(given), next(given), observe, z=next(given))


def over_single_steps(
    time: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray | None, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities (T, ...) at times (T,) by polynomials that the two ends of each step determine.

    They have degree 5, or 3 without accelerations, and take a tenth of the time of `StepEnds`, whose arguments these
    are; `q`, `v` and `a` may have any axes after the first.
    """
    from scipy.sparse import csr_array  # most runs do not need it

    ends, basis = np.concatenate([q, v] if a is None else [q, v, a]), CUBIC if a is None else QUINTIC
    columns = ends.reshape(len(ends), int(np.prod(q.shape[1:])))
    step = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 2)
    h = (time[step + 1] - time[step])[:, None]
    order, exponents = len(basis) // 2, np.arange(len(basis))
    powers = ((times - time[step])[:, None] / h) ** exponents
    units = h ** np.tile(exponents[:order], 2)
    value, slope = powers @ basis.T * units, (powers[:, :-1] * exponents[1:]) @ basis[:, 1:].T * units / h
    places = step[:, None] + np.add.outer([0, 1], len(time) * exponents[:order]).ravel()
    rows = np.arange(len(times) + 1) * len(basis)
    found = [
        csr_array((x.ravel(), places.ravel(), rows), shape=(len(times), len(ends))) @ columns for x in (value, slope)
    ]
    return found[0].reshape(len(times), *q.shape[1:]), found[1].reshape(len(times), *q.shape[1:])


#: Coefficients of Hermite's polynomials over a unit step, lowest power first: of position, velocity and acceleration at
#: its start, and of those at its end.
QUINTIC = np.array(
    [[1, 0, 0, -10, 15, -6], [0, 1, 0, -6, 8, -3], [0, 0, 0.5, -1.5, 1.5, -0.5],
     [0, 0, 0, 10, -15, 6], [0, 0, 0, -4, 7, -3], [0, 0, 0, 0.5, -1, 0.5]]
)  # fmt: skip


#: The same without accelerations.
CUBIC = np.array([[1, 0, -3, 2], [0, 1, -2, 1], [0, 0, 3, -2], [0, 0, -1, 1]], dtype=float)
