"""Differentiated runs whose steps end where a force law or its derivative is discontinuous (at a *corner*).

The result of a step across a corner is not a smooth function of the parameters. However small such a step is, the
derivative of its result lacks the effect of the change of the time at which the corner is reached. Steps therefore end
at corners, and every step uses only one side of each corner (`mbdkit_gradients.law_corners`). If the force is
discontinuous, the derivatives of the velocities change by the difference of the accelerations before and after the
corner, times the derivative of the time of the corner (P. C. Mueller, Calculation of Lyapunov exponents for dynamic
systems with discontinuities, Chaos, Solitons & Fractals 5 (1995) 1671-1681).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from mbdkit.base.errors import StepError
from mbdkit.engine.kernels.observe import Observed
from mbdkit.engine.law_conditions import LawCondition
from mbdkit.engine.observed_states import StateObserver
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.duals.differentiated_stepper import DifferentiatedStepper
from mbdkit.integrators.duals.dual_run import Seeds
from mbdkit.integrators.interface import Moment, Stepper, StepTaken, Stretch, Timetable
from mbdkit.integrators.run.run_state import MODIFIED
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit_gradients.differentiated_states import DifferentiatedStates, StateEvaluator, rate_of
from mbdkit_gradients.law_corners import ForceCondition

PLACES = (0.25, 0.5, 0.75, 1.0)  #: Shares of a step at which conditions are evaluated.
#: A corner counts as being at the start or at the end of a step if its distance from there, as a share of the step, is
#: below this.
SAME = 1e-9
#: Time after a corner, as a share of the step, at which the new sides of force laws are determined.
AHEAD = 1e-6
MOST_AT_ONCE = 8  #: Largest number of corners at the same time; if there are more, the run fails.


@dataclass(frozen=True)
class Sides:
    """Sides of force laws, and the state of a run from which on they apply.

    Attributes
    ----------
    rows, nodes
        Number of recorded states before that state, not counting the initial one, and number of nodes of integrals
        before it.
    sides
        (C,) the sides of the C conditions.
    """

    rows: int
    nodes: int
    sides: np.ndarray


@dataclass(frozen=True)
class LawCorner:
    """A corner that a run has passed.

    Attributes
    ----------
    before, after
        The state at the corner with its derivatives, computed with the sides before and after the corner.
    slope
        (K,) derivatives of the time of the corner.
    sides
        (C,) the sides after the corner.
    number, rate
        Index of the condition that changes, and the rate of its function [1/s].
    """

    before: DifferentiatedStates
    after: DifferentiatedStates
    slope: np.ndarray
    sides: np.ndarray
    number: int
    rate: float


def sides_of(stepper: Stepper) -> np.ndarray | None:
    """Return the sides (C,) that the laws of a run use; None if its mechanism has none."""
    return stepper.sides if isinstance(stepper, SidedStepper) else None


def use_sides(stepper: DifferentiatedStepper, sides: np.ndarray | None) -> None:
    """Use the given sides from now on in a run; None changes nothing."""
    if isinstance(stepper, SidedStepper) and sides is not None:
        stepper.set_sides(sides)


class SidedStepper(DifferentiatedStepper):
    """Runs a method on a mechanism with sides, and differentiates every step.

    Parameters
    ----------
    method, workspace, timetable, seeds
        See `DifferentiatedStepper`; the mechanism of the workspace is one with sides.
    conditions
        The conditions of the laws of the mechanism.
    **more
        The other parameters of `DifferentiatedStepper`. Sizes are those of whole steps, which corners split.

    Attributes
    ----------
    history
        The sides since the start of the run, with the states from which on they apply.
    corners
        The corners passed so far.
    reached
        Index of the condition at whose corner the last step ended; the next step passes it.
    """

    def __init__(
        self,
        method: CompiledMethod,
        workspace: Workspace,
        timetable: Timetable,
        seeds: Seeds,
        conditions: Sequence[ForceCondition | LawCondition],
        **more: Any,
    ):
        super().__init__(method, workspace, replace(timetable, single=True), seeds=seeds, **more)
        self.conditions = conditions
        self.history: list[Sides] = []
        self.corners: list[LawCorner] = []
        self._evaluator = StateEvaluator(self.steps, seeds.count)
        self._observer = StateObserver(workspace)
        self._at_once = 0
        self.reached: int | None = None
        self.set_sides(-np.ones(len(conditions)))
        for _ in range(MOST_AT_ONCE):  # reactions, and so the sides that depend on them, depend on other sides
            before = self.sides
            self.set_sides(np.where(self._conditions(self._here())[0] >= 0.0, 1.0, -1.0))
            if np.array_equal(self.sides, before):
                break
        self.set_sides(self._ahead(self._here()))
        self._note()

    # --- sides

    @property
    def sides(self) -> np.ndarray:
        """The sides (C,) in use."""
        return np.asarray(self._numbers[[condition.side for condition in self.conditions]])

    def set_sides(self, sides: np.ndarray) -> None:
        """Use the given sides from now on."""
        places = [condition.side for condition in self.conditions]
        self._numbers[places] = self.workspace.scratch.law_values[places] = sides
        self.steps.run.top.law_parameters[places, 0] = sides

    @property
    def _numbers(self) -> np.ndarray:
        return self.workspace.mechanism.topology.law_parameters

    def _note(self) -> None:
        self.history.append(Sides(self.recorded, int(self.steps.run.nodes[1]), self.sides))

    # --- steps

    def advance(self) -> Stretch:
        """Advance by one step, or by the part of a step up to a corner, which the next step passes."""
        if self.reached is not None:
            self._pass(self.reached)
        recorded, self.reached = self.recorded, None
        stretch = super().advance()
        step = self.last_step
        found = None if step is None or self.failure is not None else self._first_crossing(step)
        if step is None or found is None:
            self._at_once = 0
            return stretch
        theta, number = found
        if theta < 1.0 - SAME:
            self._recall(self._before)
            self.recorded, self.finished, self.failure = recorded, False, None
            self.count()
            if theta > SAME:
                self.stop_at(step.time(theta))
                stretch = super().advance()
        self._at_once = 0 if theta > SAME else self._at_once + 1
        if self._at_once > MOST_AT_ONCE:
            name = self.conditions[number].force
            raise StepError(
                "newton-failed", f"the force '{name}' switches on and off repeatedly at t = {self.time:.6g} s"
            )
        self.reached = number
        return stretch if theta > SAME else self.advance()

    def _first_crossing(self, step: StepTaken) -> tuple[float, int] | None:
        """Return the share of a step at which the first condition changes, and the index of the condition.

        None if no condition changes.
        """
        states = [self.inside(theta) for theta in PLACES[:-1]] + [step.between(1.0)]
        wrong = self._values([step.time(theta) for theta in PLACES], states) * self.sides < 0.0
        found = [one for number in np.flatnonzero(wrong.any(axis=0)) if (one := self._root(step, wrong, int(number)))]
        return min(found) if found else None

    def _root(self, step: StepTaken, wrong: np.ndarray, number: int) -> tuple[float, int] | None:
        """Return the share of the step at which a condition changes; None if steps of the method do not confirm it."""
        side = float(self.sides[number])

        def value(theta: float) -> float:
            return float(self._values([step.time(theta)], [self.within(theta)])[0, number]) * side

        begin = SAME
        if value(begin) <= 0.0:
            return 0.0, number
        for index, theta in enumerate(PLACES):
            if wrong[index, number] and value(theta) < 0.0:
                # in a long step, the interpolation from which `begin` follows may be on the wrong side
                begin = begin if value(begin) > 0.0 else SAME
                # Brent's method needs at most the square of the steps of bisection, as for multiple zeros
                return float(brentq(value, begin, theta, xtol=1e-15, maxiter=10_000)), number
            if not wrong[index, number]:
                begin = theta
        return None

    def _values(self, times: Sequence[float], states: Sequence[Moment]) -> np.ndarray:
        """Return the functions of the conditions (N, C) in N states."""
        q, v, z = (np.ascontiguousarray([state[i] for state in states]) for i in range(3))
        observed = self._observer.arrays(len(q))
        observed.forces[:] = observed.lam[:] = np.nan  # of states that have no accelerations
        self._observer.observe(np.array(times), q, v, observed, z=z)
        return np.transpose([condition.values(observed, q, v, self._numbers) for condition in self.conditions])

    # --- corners

    def _here(self) -> DifferentiatedStates:
        run = self.steps.run
        return self._evaluator.states(np.array([self.time]), *(np.array(x)[None] for x in (run.q, run.v, run.z)))

    def _conditions(self, here: DifferentiatedStates) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the functions (C,) of the conditions in a state, their derivatives (C, K), and their rates (C,)."""
        around, distance = self._evaluator.around(here, float(self.timetable.step or 1e-3))
        forces, moved = here.observed.forces[0], around.observed.forces[:, :, 1, 0]
        values, slopes, rates = [], [], []
        width = forces.shape[-1]
        numbers = np.asarray(self.steps.run.top.law_parameters)[:, :width]
        state = here.q[0, :, 0], here.v[0, :, 0], self._numbers
        directions = [(here.q[0, :, k], here.v[0, :, k], numbers[:, k]) for k in range(1, width)]
        motion = here.v[0, :, 0], here.observed.acc[0, :, 0], 0.0 * self._numbers
        for condition in self.conditions:
            if not isinstance(condition, ForceCondition):
                plain = Observed(*(x[..., 0] for x in here.observed))
                values += condition.values(plain, state[0][None], state[1][None], self._numbers)
                *own_slopes, own_rate = condition.slopes(state, [*directions, motion])
                slopes.append(np.array(own_slopes))
                rates.append(own_rate)
                continue
            length, rate = forces[condition.element, :2]
            own = condition.own(numbers, here.observed.lam[0])
            g, by_length, by_rate, *by_parameter = condition.function(length[0], rate[0], *own[:, 0])
            values.append(g)
            slopes.append(by_length * length[1:] + by_rate * rate[1:] + np.array(by_parameter) @ own[:, 1:])
            by_time = np.array([condition.own(numbers[:, 0], lam) for lam in around.observed.lam[..., 0]])
            own_rates = rate_of(by_time, own[:, 0], distance)
            turn = rate_of(moved[:, condition.element], rate[0], distance)
            rates.append(by_length * rate[0] + by_rate * turn + np.array(by_parameter) @ own_rates)
        return np.array(values), np.array(slopes), np.array(rates)

    def _ahead(self, here: DifferentiatedStates) -> np.ndarray:
        value, _, rate = self._conditions(here)
        return np.where(value + AHEAD * float(self.timetable.step or 1e-3) * rate >= 0.0, 1.0, -1.0)

    def _pass(self, number: int) -> None:
        """Pass a corner: change the sides, and the derivatives of velocities, first-order states and energies."""
        before = self._here()
        _, slope, rate = self._conditions(before)
        sides = self._ahead(before)
        sides[number] = -self.sides[number]
        with np.errstate(all="ignore"):
            moved = -slope[number] / rate[number]
        if not np.all(np.isfinite(moved)):
            name = self.conditions[number].force
            raise StepError(
                "newton-failed",
                f"the force '{name}' switches on or off tangentially (at zero rate of its condition) at t = "
                f"{self.time:.6g} s",
            )
        self.set_sides(sides)
        self.run_state.base_state[0] = self.steps.run.base_state[0] = MODIFIED
        self.method.forget()
        after = self._here()
        run, some = self.steps.run, slice(1, 1 + len(moved))
        run.v[:, some] += np.outer(before.observed.acc[0, :, 0] - after.observed.acc[0, :, 0], moved)
        run.z[:, some] += np.outer(before.observed.state_rates[0, :, 0] - after.observed.state_rates[0, :, 0], moved)
        run.energy[:, some] += np.outer(before.power[0, :, 0] - after.power[0, :, 0], moved)
        self.corners.append(LawCorner(before, after, moved, self.sides, number, float(rate[number])))
        self._note()
