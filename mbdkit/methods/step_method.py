"""Base class of integration methods written in Python, and the state that is passed between their steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    import numpy as np

    from mbdkit.engine.equations_of_motion import EquationsOfMotion


@dataclass(frozen=True, slots=True)
class StepState:
    """The state between two steps: everything that the next step needs. It can be copied, pickled and resumed from.

    Parameters
    ----------
    q, v
        (n,) positions [m, rad] and velocities [m/s, rad/s], n = 3 B: x, y, theta of each body in turn.
    multipliers
        (m,) multipliers computed by the method itself, in the order of ``/constraints``; None before the first step,
        before a step that begins at a discontinuity of a motion or load, and for methods that compute none.
    memory
        Any other data that the method needs in its next step; None before the first step, and before a step that begins
        at a discontinuity of a motion or load. Must not be modified in place.
    work, dissipated
        Work of loads and drivers, and dissipated energy, during the step that ends here, integrated with the weights
        of the method [J]; with None the framework integrates them.
    low
        Low parts of the sums computed by `moved`; for internal use.
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
        """Return the state at ``q + dq``, ``v + dv``, computed by compensated (Kahan) summation.

        Parameters
        ----------
        dq, dv
            (n,) increments.
        multipliers, memory, work, dissipated
            Values of the new state.
        """
        low_q, low_v = self.low
        dq, dv = dq + low_q, dv + low_v
        q, v = self.q + dq, self.v + dv
        return StepState(q, v, multipliers, memory, work, dissipated, (dq - (q - self.q), dv - (v - self.v)))


class StepMethod(ABC):
    """Base of a method with fixed steps that is written in Python, one step at a time.

    A subclass has its options as attributes and no attribute that changes: data that one step passes to the next belong
    in the state. The method is used for the formulations named in its claims. If a run uses projection, the framework
    changes positions and velocities between the steps and leaves the other fields of the state, including `memory`,
    unchanged. If a method cannot work in this way, it does not claim projection among its `stabilizations`.

    Attributes
    ----------
    carries_multipliers
        Whether every state returned by `step` has `multipliers`. They are recorded as ``method_multiplier``; the row
        of the start contains the index-1 multipliers.
    hint
        Advice to the user, added to the message when a step fails.

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
            The equations of motion of the mechanism; they count evaluations and solves.
        t
            Time at the beginning of the step [s].
        state
            State at `t`. It may be used for another step, so it must not be changed.
        h
            Size of the step [s]. Shorter steps occur at the end of a run, at discontinuities of motions or loads, and
            when an event is located; the latter start from the beginning of the last step.

        Returns
        -------
        StepState
            The state at ``t + h``.

        Raises
        ------
        mbdkit.StepError
            If the step cannot be taken. Any other exception counts as a failure of the plugin.
        """
