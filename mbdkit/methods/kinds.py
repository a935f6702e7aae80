"""Descriptions of integration methods. The `create` function of an integrator plugin returns one of these objects.

Each description has traits, by which the rest of mbdkit decides what can be done with the method.
`mbdkit.integrators.start.start_method` creates the stepper that executes the method.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Never

from mbdkit.base.frozen import dataclass
from mbdkit.engine.formulation import INDEX_1, Formulation
from mbdkit.methods.tableau import ButcherTableau, EmbeddedPair, TableauError
from mbdkit.registry.seam import OwnSeam
from mbdkit.registry.target import Target

if TYPE_CHECKING:
    from mbdkit.engine.compiled_mechanism import CompiledMechanism
    from mbdkit.methods.step_filter import StepFilter


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
        characteristic length if that is below 1 m; see `mbdkit.integrators.run.step_control.unit_of_length`.
    control
        Coefficients of the controller that `integrator.step_control` of the spec chooses; None for the default one.
    """

    rtol: float
    atol: float
    max_step: float | None = None
    by_size: bool = False
    control: StepFilter | None = None


@dataclass(frozen=True)
class LocalError:
    """How a compiled method estimates the error of a step; see `mbdkit.integrators.run.step_control.Control`."""

    order: int
    estimate_order: int
    estimates: int = 1
    memory: float = 0.0


@dataclass(frozen=True)
class Traits:
    """Properties of a method that the rest of mbdkit uses, independent of the class of the method.

    Parameters
    ----------
    compiled
        Class of the method in machine code (`mbdkit.integrators.stages.compiled_method`), which is called with the
        method, a workspace, and the control of the step size or None; None for steps in Python.
    steps
        Function that returns the `StepMethod` or `ExternalMethod` from the description; None if it is one itself.
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
    lanes
        The form that advances runs in SIMD lanes (`mbdkit.integrators.lanes.lane_run.InLanes`); None if there is none.
    has_derivatives
        Whether steps can be differentiated with respect to parameters.
    is_time_stepping
        Whether velocities may jump in any step, so that the method does not locate impacts of elements.
    integrates_states
        Whether the method integrates first-order states of elements; None if its claims say so.
    holds_states
        Whether states that are constant during a step, such as inputs, keep their values if the method integrates none.
    why_no_checkpoint
        Reason why the state of a run cannot be stored, as a clause; empty if it can.
    """

    compiled: Target[Callable[..., Any]] | None = None
    steps: Target[Callable[[Any], Any]] | None = None
    tableau: ButcherTableau | None = None
    tolerances: Tolerances | None = None
    local_error: LocalError | None = None
    is_explicit: bool = False
    suits_stiff: bool = False
    iterates_without_tangents: bool = False
    own_multipliers: Literal["always", "where solved for", "never"] = "never"
    lanes: Target[Any] | None = None
    has_derivatives: bool = False
    is_time_stepping: bool = False
    integrates_states: bool | None = True
    holds_states: bool = False
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


@OwnSeam
def integrator_method(options: Never, /) -> Method:
    """Return the method with these options."""
    raise NotImplementedError


@dataclass(frozen=True)
class ExplicitRungeKutta(Method):
    """An explicit Runge-Kutta method for the index-1 equations, with fixed or controlled step size.

    Parameters
    ----------
    pair
        Error estimates and dense output, if there are any.
    tolerances
        Tolerances for a controlled step size, which requires a `pair` with error estimates; None for fixed steps.
    """

    tableau: ButcherTableau
    pair: EmbeddedPair | None = None
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if not self.tableau.is_explicit:
            raise TableauError(f"{self.tableau.name} is implicit: its stages need ImplicitRungeKutta")
        if self.tolerances is not None and (self.pair is None or not len(self.pair.error)):
            raise TableauError(f"{self.tableau.name} has no error estimate, which tolerances require")

    @cached_property
    def traits(self) -> Traits:
        """See `Method`."""
        local_error = None
        if self.tolerances is not None and self.pair is not None:
            local_error = LocalError(self.tableau.order, self.pair.estimate_order, len(self.pair.error), memory=0.2)
        return Traits(
            Target("mbdkit.integrators.stages.explicit:CompiledExplicit"),
            tableau=self.tableau,
            tolerances=self.tolerances,
            local_error=local_error,
            is_explicit=True,
            lanes=Target("mbdkit.integrators.lanes.lane_control:EXPLICIT_IN_LANES"),
            has_derivatives=True,
        )


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
        return Traits(
            Target("mbdkit.integrators.stages.collocation:CompiledCollocation") if is_together else None,
            None if is_together else Target("mbdkit.integrators.stages.diagonally_implicit:DiagonallyImplicit"),
            tableau=tableau,
            tolerances=self.tolerances,
            local_error=LocalError(tableau.order, tableau.stages + 1) if is_controlled else None,
            suits_stiff=True,
            iterates_without_tangents=self.stage_solver == "fixed-point",
            own_multipliers="where solved for",
            lanes=Target("mbdkit.integrators.lanes.lane_collocation:COLLOCATION_IN_LANES") if is_together else None,
            has_derivatives=is_together,
            integrates_states=is_together,
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
        compiled = Target[Any]("mbdkit.integrators.stages.lobatto_iiia_iiib:CompiledLobattoPair")
        return Traits(compiled, suits_stiff=True, own_multipliers="always")

    def require_mechanism(self, mechanism: CompiledMechanism) -> None:
        """See `Method`: first-order states are not supported."""
        mechanism.refuse_states("a Lobatto pair")
