"""A method as a class with `step`, written in NumPy: what its author derives from, returns and raises."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, final

if TYPE_CHECKING:
    import numpy as np

    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.engine.workspace import Workspace
    from mbdkit.stepping.interface import Stepper, Timetable


class StepError(Exception):
    """A step that cannot be taken; the run ends as failed, with this reason and all that was recorded before.

    `EquationsOfMotion` raises it if the equations have no unique or no finite solution; a method raises it if its own
    iteration does not converge.

    Parameters
    ----------
    code
        Reason as the archive names it.
    sentence
        What went wrong, without the time, and without a full stop.
    """

    def __init__(self, code: Literal["newton-failed", "singular", "not-finite", "step-too-small"], sentence: str):
        super().__init__(code, sentence)
        self.code, self.sentence = code, sentence

    def __str__(self) -> str:
        return self.sentence


@dataclass(frozen=True, slots=True)
class StepState:
    """The state between two steps: everything that the next step needs; it can be copied, pickled and gone on from.

    Parameters
    ----------
    q, v
        (n,) positions [m, rad] and velocities [m/s, rad/s], n = 3 B: x, y, theta of each body in turn.
    multipliers
        (m,) the multipliers that the method itself carries, in the order of ``/constraints``; None before the first
        step, and for methods that carry none.
    memory
        Whatever else the method has to remember; None before the first step. Never changed in place.
    work, dissipated
        Work of loads and drivers, and energy dissipated, in the step that led here, by the method's own weights [J];
        None where the method leaves them to the framework.
    low
        Low parts of the sums that `moved` takes; not for use.
    """

    q: np.ndarray
    v: np.ndarray
    multipliers: np.ndarray | None = None
    memory: Any = None
    work: float | None = None
    dissipated: float | None = None
    low: tuple[Any, Any] = (0.0, 0.0)

    def moved(
        self,
        dq: np.ndarray,
        dv: np.ndarray,
        *,
        multipliers: np.ndarray | None = None,
        memory: Any = None,
        work: float | None = None,
        dissipated: float | None = None,
    ) -> StepState:
        """Return the state at ``q + dq``, ``v + dv``, whose rounding errors are carried along (Kahan's summation).

        Parameters
        ----------
        dq, dv
            (n,) increments.
        multipliers, memory, work, dissipated
            As the new state is to have them.
        """
        low_q, low_v = self.low
        dq, dv = dq + low_q, dv + low_v
        q, v = self.q + dq, self.v + dv
        return StepState(q, v, multipliers, memory, work, dissipated, (dq - (q - self.q), dv - (v - self.v)))


class StepMethod(ABC):
    """Base of a method in fixed steps that is written in Python, one step at a time.

    A subclass holds its options and nothing that changes: what one step hands to the next belongs in the state. It
    serves a formulation that its claims name. Positions and velocities are touched between its steps only where a run
    asks for projection; what else the state carries, its memory too, is then handed on as it is. A method that cannot
    bear that says so in the `stabilizations` that it claims.

    Attributes
    ----------
    carries_multipliers
        Whether every state that `step` returns brings `multipliers`, which are then recorded as ``method_multiplier``;
        the row of the start holds the index-1 multipliers.
    hint
        What a user may try when a step fails.

    Examples
    --------
    >>> class SymplecticEuler(StepMethod):
    ...     def step(self, equations, t, state, h):
    ...         a, _ = equations.accelerations(t, state.q, state.v)
    ...         return state.moved(h * (state.v + h * a), h * a)
    """

    carries_multipliers: ClassVar[bool] = False
    hint: ClassVar[str] = "a smaller time.step may help"

    @abstractmethod
    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState:
        """Take one step.

        Parameters
        ----------
        equations
            The mechanism's equations; it counts what is evaluated and solved.
        t
            Time at the beginning of the step [s].
        state
            State there; it may be gone on from again, so nothing of it may be changed.
        h
            Size of the step [s]; the last one of a run may be shorter than the others, and so are those that locate
            an event, which begin where the last step began.

        Returns
        -------
        StepState
            The state at ``t + h``.

        Raises
        ------
        StepError
            Where the step cannot be taken. Any other exception counts as a failure of the plugin.
        """

    @final
    def start(self, workspace: Workspace, timetable: Timetable) -> Stepper:
        """Return a stepper for `workspace` over `timetable`."""
        from mbdkit.stepping.python_stepper import StepStepper

        return StepStepper(self, workspace, timetable)
