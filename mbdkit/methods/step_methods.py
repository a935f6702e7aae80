"""Methods written in Python: one step at a time (`StepMethod`), or by a library that steps itself (`ExternalMethod`).

`mbdkit.integrators.host.step_host.StepHost` runs both.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import numpy as np

from mbdkit.base.frozen import dataclass, field
from mbdkit.methods.kinds import Method, Tolerances, Traits

if TYPE_CHECKING:
    from mbdkit.engine.equations_of_motion import EquationsOfMotion

#: Why a step begins anew: at the start of the run, at a discontinuity of a motion or load, after an event that has set
#: states, after an impulse, or after a projection.
Why = Literal["start", "stop", "event", "impact", "projection"]
Dense = Callable[[float], "tuple[np.ndarray, ...]"]


@dataclass(frozen=True, slots=True)
class StepState:
    """The state between two steps: everything that the next step needs. It can be copied, pickled and resumed from.

    Parameters
    ----------
    q, v
        (n,) positions [m, rad] and velocities [m/s, rad/s], n = 3 B: x, y, theta of each body in turn.
    multipliers
        (m,) multipliers computed by the method itself, in the order of ``/constraints``; None before a step that begins
        anew (see `StepMethod.begin`), except after a projection, and for methods that compute none.
    memory
        Any other data that the method needs in its next step, which must not be modified in place. Runs whose memory is
        None, a number, a text, an array, or a list, tuple or mapping of these can be resumed, and so can those whose
        memory has the methods ``stored()``, which returns such data, and ``restored(data)``.
    work, dissipated
        Work of loads and drivers, and dissipated energy, during the step that ends in this state, integrated with the
        weights of the method [J]. If None, the framework integrates them.
    low
        Compensation terms of the sums computed by `moved`; for internal use.
    z
        (Z,) first-order states of elements, such as those of controllers; none by default.
    """

    q: np.ndarray
    v: np.ndarray
    multipliers: np.ndarray | None = None
    memory: Any = None
    work: float | None = None
    dissipated: float | None = None
    low: tuple[Any, ...] = (0.0, 0.0)
    z: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def moved(
        self,
        dq: np.ndarray,
        dv: np.ndarray,
        dz: np.ndarray | float = 0.0,
        *,
        multipliers: np.ndarray | None = None,
        memory: object = None,
        work: float | None = None,
        dissipated: float | None = None,
    ) -> StepState:
        """Return the state at ``q + dq``, ``v + dv``, ``z + dz``, computed by compensated (Kahan) summation.

        Parameters
        ----------
        dq, dv, dz
            (n,), (n,) and (Z,) increments.
        multipliers, memory, work, dissipated
            Values of the new state.
        """
        low_q, low_v, *low_z = self.low
        dq, dv = dq + low_q, dv + low_v
        q, v = self.q + dq, self.v + dv
        low: tuple[Any, ...] = dq - (q - self.q), dv - (v - self.v)
        z = self.z
        if len(z):
            dz = dz + low_z[0] if low_z else dz
            z = self.z + dz
            low = (*low, dz - (z - self.z))
        return StepState(q, v, multipliers, memory, work, dissipated, low, z)

    def interpolant(
        self,
        h: float,
        change: tuple[np.ndarray, np.ndarray, np.ndarray],
        accelerations: tuple[np.ndarray, np.ndarray],
        rates: tuple[np.ndarray, np.ndarray],
    ) -> Dense:
        """Return the dense output of a step from this state: the polynomial of degree 5 in q with the positions,
        velocities and accelerations of both ends, its derivative in v, and the cubic polynomial with the values and
        rates of both ends in z.

        Parameters
        ----------
        h
            Size of the step [s].
        change
            Changes of positions (n,), velocities (n,) and first-order states (Z,).
        accelerations, rates
            (n,) and (Z,) values at both ends.
        """
        (dq, dv, dz), (a, a1), (r, r1) = change, accelerations, rates
        v = h * self.v
        of_q, of_v, of_a = dq - v - h**2 / 2 * a, h * dv - h**2 * a, h**2 * (a1 - a)
        c3, c4, c5 = 10 * of_q - 4 * of_v + of_a / 2, 7 * of_v - 15 * of_q - of_a, 6 * of_q - 3 * of_v + of_a / 2
        of_z, of_r = dz - h * r, h * (r1 - r)

        def dense(x: float) -> tuple[np.ndarray, ...]:
            q = self.q + x * (v + x * (h**2 / 2 * a + x * (c3 + x * (c4 + x * c5))))
            velocity = self.v + x * (h * a + x / h * (3 * c3 + x * (4 * c4 + x * 5 * c5)))
            z = self.z + x * (h * r + x * (3 * of_z - of_r + x * (of_r - 2 * of_z)))
            return q, velocity, z

        return dense


class StepEvent(Protocol):
    """An event at which a step ends before its planned end, such as an impact."""

    @property
    def time(self) -> float:
        """Time of the event [s]."""
        ...

    def apply(self, equations: EquationsOfMotion, t: float, state: StepState) -> StepState:
        """Return the state after the event at time `t` [s], before which it is `state`.

        Its `work` and `dissipated` are those of the event.
        """
        ...


@dataclass(frozen=True, slots=True)
class Step:
    """A step of a method, with more than its end.

    Parameters
    ----------
    state
        The state at the end of the step.
    error
        (2 n + Z,) estimate of the local error of q, v and z. With `StepMethod.tolerances`, the framework accepts or
        rejects the step and chooses the size of the next one by it. None if the method does not estimate it.
    dense
        Function that returns the state (q, v, z) at a share of the step, from 0 at its start to 1 at its end. It may
        return the work and the dissipated energy [J] since the start of the step as well: (q, v, z, work, dissipated).
        Without it, states within the step come from the cubic through both ends, and first-order states from a line:
        events, rows at an interval and energies that the method does not return are then no better than of order 3 or
        4, however good the step is. That of a `StepMethod` may be called after other steps have been taken. That of an
        `ExternalMethod` is called only until the next `advance` or `open`, so that it may use the state of the library.
    next_step
        Size of the next step, or of the next attempt if this one is rejected [s]; chosen by the framework if None. An
        `ExternalMethod` chooses its steps itself: with this size it is opened again after a projection.
    next_order
        Order of the error estimate of the next step, if it varies.
    accepted
        Whether the method accepts its step. A rejected step is repeated with the size `next_step`, or half the size.
        In a run with fixed steps, the rest of the fixed step follows in further steps.
    stages
        Quadrature nodes of the step for integrals over time: times (S,) [s], weights (S,) [s], and the states there,
        q and v (S, n). By default, nodes are placed on an interpolant of the step.
    event
        The event at which the step has ended; the next step starts after it.
    time
        Time at the end of the step [s]. Required from `ExternalMethod.advance`. A `StepMethod` may end its step before
        the time that it is asked for, and says so here.
    """

    state: StepState
    error: np.ndarray | None = None
    dense: Dense | None = None
    next_step: float | None = None
    next_order: float | None = None
    accepted: bool = True
    stages: tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]] | None = None
    event: StepEvent | None = None
    time: float | None = None


class _InPython(Method):
    """Properties that all methods in Python share."""

    carries_multipliers: ClassVar[bool] = False
    tolerances: Tolerances | None = None
    hint: str = ""

    @property
    def advice(self) -> str:
        """The hint, or general advice."""
        return self.hint or (
            "a smaller time.step may help" if self.tolerances is None else "tighter tolerances may help"
        )


class StepMethod(_InPython):
    """Base class of methods that are written in Python, one step at a time.

    A subclass has its options as attributes, and no attributes that change: data that one step passes to the next
    belong to the state. The method is used with the formulations named in its claims. If a run uses projection, the
    framework changes positions and velocities between the steps, and `begin` may then change the memory; by default it
    does not. A method that cannot work in this way must not claim projection among its `stabilizations`.

    Attributes
    ----------
    carries_multipliers
        Whether every state returned by a step has `multipliers`. They are recorded as ``method_multiplier``; the
        index-1 multipliers are recorded for the initial state.
    tolerances
        `mbdkit.Tolerances` of a method that chooses its steps, as a class attribute or in the instance; None for fixed
        steps. Steps with an `error` are controlled by the framework; otherwise, the method itself sets `next_step` and
        `accepted`.
    hint
        Advice to the user, added to the message when a step fails.
    error_order
        Order p of the error estimate, whose size is O(h^(p + 1)); `Step.next_order` overrides it.

    Examples
    --------
    >>> class SymplecticEuler(StepMethod):
    ...     def step(self, equations, t, state, h):
    ...         a, _ = equations.accelerations(t, state.q, state.v)
    ...         return state.moved(h * (state.v + h * a), h * a)
    """

    error_order: float = 3.0

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        own: Literal["always", "never"] = "always" if self.carries_multipliers else "never"
        return Traits(tolerances=self.tolerances, own_multipliers=own, integrates_states=None)

    def begin(self, equations: EquationsOfMotion, t: float, state: StepState, why: Why) -> Any:
        """Return the memory for a step that begins anew; None by default, but after a projection the memory is kept.

        Parameters
        ----------
        equations
            The equations of motion.
        t
            Time at which the step begins [s].
        state
            State at `t`, with the memory of the previous step.
        why
            ``start``, ``stop`` (a discontinuity of a motion, a load or their derivatives, or a sample of a controller),
            ``event`` (one that has set states), ``impact`` (the velocities have jumped) or ``projection``.
        """
        return state.memory if why == "projection" else None

    @abstractmethod
    def step(self, equations: EquationsOfMotion, t: float, state: StepState, h: float) -> StepState | Step:
        """Take one step.

        Parameters
        ----------
        equations
            The equations of motion of the mechanism; they count evaluations and solves.
        t
            Time at the beginning of the step [s].
        state
            State at `t`. It must not be changed, because it may be used for another step.
        h
            Size of the step [s]. Shorter steps occur at the end of a run, at discontinuities of motions or loads, and
            when an event is located; in the last case they start from the beginning of the last step.

        Returns
        -------
        StepState or Step
            The state at ``t + h``, or a `Step` with that state and its error estimate, dense output, and more.

        Raises
        ------
        mbdkit.StepError
            If the step cannot be taken. A run with controlled steps tries a smaller one. Any other exception counts as
            a failure of the plugin.
        """


class ExternalMethod(_InPython):
    """Base class of methods that are taken by a library with a loop of its own, such as SUNDIALS.

    The library chooses its steps. Every run has its own copy (`copy.copy`) of the method, whose attributes may
    therefore change after `open`. `carries_multipliers`, `tolerances` and `hint` are those of `StepMethod`.

    If a run uses projection, the library is opened again after every step that has been projected, from the projected
    state and with the size `Step.next_step` of the step before. A one-step method then continues with steps of the same
    size, at the cost of the evaluations that it starts with. A multistep method loses its history and starts again with
    low order and small steps, so it should not claim projection among its `stabilizations`. Symmetric projection
    repeats steps from displaced states, which a library cannot do.

    Examples
    --------
    >>> class Bdf(ExternalMethod):
    ...     tolerances = Tolerances(1e-8, 1e-10)
    ...
    ...     def open(self, equations, t, state, stop):
    ...         self.solver = library_solver(equations.derivatives, t, state, stop)
    ...
    ...     def advance(self):
    ...         t, q, v, z = self.solver.one_step()
    ...         return Step(StepState(q, v, z=z), time=t)
    """

    tolerances: Tolerances | None = Tolerances(1e-6, 1e-8)

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        own: Literal["always", "never"] = "always" if self.carries_multipliers else "never"
        names, own_class = ("save", "restore"), type(self)
        is_stored = all(getattr(own_class, name) is not getattr(ExternalMethod, name) for name in names)
        why = "" if is_stored else "its library offers no way to store its state"
        return Traits(
            tolerances=self.tolerances,
            suits_stiff=True,
            own_multipliers=own,
            integrates_states=None,
            why_no_checkpoint=why,
        )

    @abstractmethod
    def open(self, equations: EquationsOfMotion, t: float, state: StepState, stop: float) -> None:
        """Start the library from a state; called at the start of a run, and after discontinuities and projections.

        Parameters
        ----------
        equations
            The equations of motion; ``equations.first_step`` is the size of the first step [s], at most ``stop - t``:
            that which the user asks for or, after a projection, `Step.next_step`. None if the library should choose it.
            No step may be longer than ``equations.longest_step``.
        t, state
            Time [s] and state from which the library starts.
        stop
            Time of the next discontinuity or of the end of the run [s], which no step may pass.
        """

    @abstractmethod
    def advance(self) -> Step:
        """Take one step of the library, at most to `stop`; `Step.time` is where it ends. Raises StepError.

        `Step.dense` is called only before the next call of `advance` or `open`.
        """

    def cut(self, t: float) -> StepState | None:
        """Return the state at a time [s] within the last step; None, the default, for that of `Step.dense`."""
        return None

    def save(self) -> bytes | None:
        """Return the state of the library, from which `restore` continues to the same bits; None if it has no such."""
        return None

    def restore(self, stored: bytes) -> None:
        """Continue from a stored state; called after `open`, with the same equations, if a method has `save`."""
