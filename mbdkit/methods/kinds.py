"""Descriptions of integration methods. The `create` function of an integrator plugin returns one of these objects.

Each description has traits, by which the rest of mbdkit decides what can be done with the method.
`mbdkit.integrators.start.start_method` creates the stepper that executes the method, depending on its family.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from mbdkit.engine.formulation import INDEX_1, Formulation
from mbdkit.engine.known_series import require_series
from mbdkit.methods.tableau import ButcherTableau, TableauError

if TYPE_CHECKING:
    import numpy as np

    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.engine.equations_of_motion import EquationsOfMotion
    from mbdkit.methods.tableau import EmbeddedPair


@dataclass(frozen=True)
class Tolerances:
    """Error tolerances of a method with controlled step size.

    Parameters
    ----------
    rtol, atol
        Relative tolerance, and absolute tolerance [m, rad, m/s, rad/s].
    max_step
        Largest step [s]; None for no limit.
    by_size
        Whether `atol` has its default value. For lengths and velocities, the default is multiplied by the mechanism's
        characteristic length if that is below 1 m; see `mbdkit.integrators.step_control.unit_of_length`.
    """

    rtol: float
    atol: float
    max_step: float | None = None
    by_size: bool = False


@dataclass(frozen=True)
class LocalError:
    """How a compiled method estimates the error of a step; see `mbdkit.integrators.step_control.Control`."""

    order: int
    estimate_order: int
    estimates: int = 1
    memory: float = 0.0


@dataclass(frozen=True)
class Traits:
    """Properties of a method that the rest of mbdkit uses, independent of the class of the method.

    Parameters
    ----------
    family
        Key of the method's algorithm in the tables of `mbdkit.integrators.start` and `mbdkit_studies.lane_stepper`.
    tableau
        Tableau of the method; None if it is not a Runge-Kutta method, or the tableau is not known.
    tolerances
        Tolerances of controlled steps; None for fixed steps.
    local_error
        How the error of a step is estimated, if compiled code controls the step size.
    is_explicit
        Whether a step evaluates accelerations at known states only. False if this is not known.
    suits_stiff
        Whether the method is intended for stiff mechanisms. Its runs are then compared with runs of further implicit
        methods.
    iterates_without_tangents
        Whether stages are solved by fixed-point iteration.
    own_multipliers
        In which runs the method computes multipliers itself: in runs with any formulation, only in runs with a
        formulation whose stages solve for multipliers, or never.
    has_lanes, has_derivatives
        Whether runs can be advanced in SIMD lanes, and whether steps can be differentiated with respect to parameters.
    can_be_projected
        Whether states may be changed between the steps.
    is_time_stepping
        Whether velocities may jump in any step, so that the method integrates contacts without locating impacts.
    why_no_checkpoint
        Reason why the state of a run cannot be stored, as a clause; empty if it can.
    """

    family: str
    tableau: ButcherTableau | None = None
    tolerances: Tolerances | None = None
    local_error: LocalError | None = None
    is_explicit: bool = False
    suits_stiff: bool = False
    iterates_without_tangents: bool = False
    own_multipliers: Literal["always", "where solved for", "never"] = "never"
    has_lanes: bool = False
    has_derivatives: bool = False
    can_be_projected: bool = True
    is_time_stepping: bool = False
    why_no_checkpoint: str = ""

    def carries_multipliers(self, formulation: Formulation) -> bool:
        """Return whether the method computes multipliers itself in runs of a formulation."""
        return self.own_multipliers == "always" or (
            self.own_multipliers == "where solved for" and formulation.solves_multipliers
        )


class Method(ABC):
    """Base class of all descriptions of methods."""

    @property
    @abstractmethod
    def traits(self) -> Traits:
        """Properties of the method that the rest of mbdkit uses."""

    def require_formulation(self, formulation: Formulation) -> None:  # noqa: B027
        """Raise TableauError if the steps cannot be taken with a formulation that the claims allow."""

    def require_mechanism(self, mechanism: CompiledMechanism) -> None:  # noqa: B027
        """Raise UnsupportedMechanismError if the method does not support an element of a mechanism."""


@dataclass(frozen=True)
class ExplicitRungeKutta(Method):
    """An explicit Runge-Kutta method for the index-1 equations, with fixed or controlled step size.

    Parameters
    ----------
    pair
        Error estimates and dense output, if there are any.
    tolerances
        Tolerances for a controlled step size, which requires a `pair`; None for fixed steps.
    """

    tableau: ButcherTableau
    pair: EmbeddedPair | None = None
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if not self.tableau.is_explicit:
            raise TableauError(f"{self.tableau.name} is implicit: its stages need ImplicitRungeKutta")
        if self.tolerances is not None and self.pair is None:
            raise TableauError(f"{self.tableau.name} has no error estimate, which tolerances require")

    @cached_property
    def traits(self) -> Traits:
        """See `Method`."""
        local_error = None
        if self.tolerances is not None and self.pair is not None:
            local_error = LocalError(self.tableau.order, self.pair.estimate_order, len(self.pair.error), memory=0.2)
        return Traits(
            "explicit",
            tableau=self.tableau,
            tolerances=self.tolerances,
            local_error=local_error,
            is_explicit=True,
            has_lanes=True,
            has_derivatives=True,
        )


@dataclass(frozen=True)
class TaylorSeries(Method):
    """Taylor series of the joint coordinates of a tree of pins, with fixed or controlled step size.

    Parameters
    ----------
    order
        Order of the series of velocities, 4 or more.
    tolerances
        Tolerances for a controlled step size; None for fixed steps.
    """

    order: int
    tolerances: Tolerances | None = None

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        return Traits(
            "taylor",
            tolerances=self.tolerances,
            local_error=None if self.tolerances is None else LocalError(self.order, self.order),
            is_explicit=True,
            can_be_projected=False,
        )

    def require_mechanism(self, mechanism: CompiledMechanism) -> None:
        """See `Method`."""
        require_series(mechanism)


@dataclass(frozen=True)
class ImplicitRungeKutta(Method):
    """An implicit Runge-Kutta method, whose stages are solved in second-order form.

    Parameters
    ----------
    tableau
        Coefficients of the method; ``a`` must be diagonalisable or lower triangular. If it is diagonalisable, compiled
        code solves for all stages together; otherwise stages are solved one after the other, for index-1 only, at the
        speed of a method written in Python.
    stage_solver
        Simplified Newton on accelerations and multipliers, or fixed-point iteration on accelerations.
    tolerance
        Change of the stage accelerations, relative to their size, at which the iteration ends. If None, it ends at
        stagnation or, with `tolerances`, at a small fraction of these.
    max_iterations
        Largest number of iterations in one step, after which the step fails. If None, 50, or more for fixed steps that
        converge slowly and would fail otherwise.
    tolerances
        Tolerances for a controlled step size, which requires a collocation method; None for fixed steps.
    """

    tableau: ButcherTableau
    stage_solver: Literal["newton", "fixed-point"] = "newton"
    tolerance: float | None = None
    max_iterations: int | None = None
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if not self.tableau.is_diagonalisable and not self.tableau.is_diagonally_implicit:
            raise TableauError(
                f"the matrix of {self.tableau.name} is neither diagonalisable nor lower triangular, so that its stages "
                "can be solved neither together nor one after the other"
            )
        if self.tolerances is not None and not self.tableau.is_collocation:
            raise TableauError(f"{self.tableau.name} is not a collocation method, so its error cannot be estimated")

    @cached_property
    def traits(self) -> Traits:
        """See `Method`."""
        tableau, is_controlled = self.tableau, self.tolerances is not None
        is_together = tableau.is_diagonalisable
        in_python = f"the steps of {tableau.name} are taken in Python, and their state cannot be stored"
        return Traits(
            "collocation" if is_together else "diagonally-implicit",
            tableau=tableau,
            tolerances=self.tolerances,
            local_error=LocalError(tableau.order, tableau.stages + 1) if is_controlled else None,
            suits_stiff=True,
            iterates_without_tangents=self.stage_solver == "fixed-point",
            own_multipliers="where solved for",
            has_lanes=is_together,
            has_derivatives=is_together,
            why_no_checkpoint="" if is_together else in_python,
        )

    def require_formulation(self, formulation: Formulation) -> None:
        """See `Method`."""
        if formulation == INDEX_1:
            return
        refused = f"{self.tableau.name} cannot be used with the formulation {formulation.name!r}"
        if not self.tableau.is_diagonalisable:
            raise TableauError(
                f"{refused}: its stages can only be solved one after the other, which this formulation does not "
                "support; use index-1"
            )
        if formulation.solves_multipliers and not (self.tableau.is_stiffly_accurate and self.stage_solver == "newton"):
            raise TableauError(
                f"{refused}, which requires a stiffly accurate tableau with a regular matrix, and the stage solver "
                "'newton'"
            )


@dataclass(frozen=True)
class LobattoPair(Method):
    """A partitioned Lobatto IIIA-IIIB pair with fixed steps.

    Positions and velocities satisfy the constraints at the end of every step.

    Parameters
    ----------
    stages
        2 (RATTLE) or 3.
    tolerance
        Expected change of positions, relative to their size, at which the iteration ends. If None, it ends at
        stagnation.
    max_iterations
        Largest number of iterations in one step, after which the step fails. For None, see `ImplicitRungeKutta`.
    """

    stages: int
    tolerance: float | None = None
    max_iterations: int | None = None

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        return Traits("partitioned", suits_stiff=True, own_multipliers="always")


@dataclass(frozen=True)
class SciPySolver(Method):
    """A solver class of ``scipy.integrate`` for the first-order form y = (q, v, work, dissipated).

    Parameters
    ----------
    solver
        Name of the `OdeSolver` subclass in ``scipy.integrate``, or the class itself.
    needs_jacobian
        Whether the solver uses the Jacobian of the right-hand side; it then receives the exact one.
    max_step
        Largest step [s], passed to the solver unless it is None.
    by_size
        See `Tolerances`.
    """

    solver: str | type[Any]
    rtol: float
    atol: float
    needs_jacobian: bool = False
    max_step: float | None = None
    by_size: bool = False

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        return Traits(
            "scipy",
            tolerances=Tolerances(self.rtol, self.atol or self.rtol, self.max_step, self.by_size),
            suits_stiff=True,
            can_be_projected=False,
            why_no_checkpoint="SciPy offers no way to store the state of its solvers",
        )


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
        Work of loads and drivers, and dissipated energy, during the step that ends in this state, integrated with the
        weights of the method [J]. If None, the framework integrates them.
    low
        Compensation terms of the sums computed by `moved`; for internal use.
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


class StepMethod(Method):
    """Base class of methods with fixed steps that are written in Python, one step at a time.

    A subclass has its options as attributes, and no attributes that change: data that one step passes to the next
    belong to the state. The method is used with the formulations named in its claims. If a run uses projection, the
    framework changes positions and velocities between the steps, and does not change the other fields of the state,
    including `memory`. A method that cannot work in this way must not claim projection among its `stabilizations`.

    Attributes
    ----------
    carries_multipliers
        Whether every state returned by `step` has `multipliers`. They are recorded as ``method_multiplier``; the
        index-1 multipliers are recorded for the initial state.
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

    @property
    def traits(self) -> Traits:
        """See `Method`."""
        return Traits(
            "python",
            own_multipliers="always" if self.carries_multipliers else "never",
            why_no_checkpoint="the state of a method written in Python cannot be stored",
        )

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
            State at `t`. It must not be changed, because it may be used for another step.
        h
            Size of the step [s]. Shorter steps occur at the end of a run, at discontinuities of motions or loads, and
            when an event is located; in the last case they start from the beginning of the last step.

        Returns
        -------
        StepState
            The state at ``t + h``.

        Raises
        ------
        mbdkit.StepError
            If the step cannot be taken. Any other exception counts as a failure of the plugin.
        """
