"""What an integrator plugin's `create` returns: the method as data, and the stepper that it starts.

A method says how it is stepped: `start` takes a `mbdkit.engine.workspace.Workspace` and returns an object that the
simulation advances. Heavy modules are imported there, not here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from mbdkit.methods.tableau import ButcherTableau, TableauError
from mbdkit.stepping.python_method import StepMethod

if TYPE_CHECKING:
    from mbdkit.engine.workspace import Workspace
    from mbdkit.methods.embedded_estimate import EmbeddedPair
    from mbdkit.stepping.interface import Stepper, Timetable


@dataclass(frozen=True)
class Tolerances:
    """Error tolerances of a method that chooses its own steps.

    Parameters
    ----------
    rtol, atol
        Relative, and absolute [m, rad, m/s, rad/s].
    """

    rtol: float
    atol: float


@dataclass(frozen=True)
class ExplicitRungeKutta:
    """An explicit Runge-Kutta method on the index-1 equations, in fixed steps or in steps of its own choice.

    Parameters
    ----------
    tableau
        Its coefficients.
    pair
        Error estimates and dense output, if the method has them.
    tolerances
        For steps of its own choice, which need a `pair`; None: fixed steps.
    """

    tableau: ButcherTableau
    pair: EmbeddedPair | None = None
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if not self.tableau.is_explicit:
            raise TableauError(f"{self.tableau.name} is implicit: its stages need ImplicitRungeKutta")
        if self.tolerances is not None and self.pair is None:
            raise TableauError(f"{self.tableau.name} has no error estimate to choose its steps by")

    def start(self, workspace: Workspace, timetable: Timetable) -> Stepper:
        """Return a stepper for `workspace` over `timetable`."""
        from mbdkit.stepping.compiled_stepper import CompiledStepper
        from mbdkit.stepping.explicit import ExplicitFamily
        from mbdkit.stepping.step_control import Control

        control = None
        if self.tolerances is not None and self.pair is not None:
            control = Control(
                self.tolerances.rtol,
                self.tolerances.atol,
                order=self.tableau.order,
                estimate_order=self.pair.estimate_order,
                estimates=len(self.pair.error),
                memory=0.2,
            )
        return CompiledStepper(ExplicitFamily(self, workspace), workspace, timetable, control)


@dataclass(frozen=True)
class ImplicitRungeKutta:
    """A fully implicit Runge-Kutta method, stages solved in second-order form.

    Parameters
    ----------
    tableau
        Its coefficients; ``a`` must be diagonalisable.
    stage_solver
        Simplified Newton on accelerations and multipliers, or fixed-point iteration on accelerations.
    tolerance
        Change of the stage accelerations, relative to their size, at which the iteration ends; None: at stagnation, or
        with `tolerances` where it is small against these.
    max_iterations
        Iterations in one step after which the stage equations count as unsolved.
    tolerances
        For steps of its own choice, which need a collocation method; None: fixed steps.
    """

    tableau: ButcherTableau
    stage_solver: Literal["newton", "fixed-point"] = "newton"
    tolerance: float | None = None
    max_iterations: int = 50
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if not self.tableau.is_diagonalisable:
            raise TableauError(
                f"the matrix of {self.tableau.name} cannot be diagonalised, which the transformed stage equations need"
            )
        if self.tolerances is not None and not self.tableau.is_collocation:
            raise TableauError(f"{self.tableau.name} is no collocation method, whose error could be estimated")

    def start(self, workspace: Workspace, timetable: Timetable) -> Stepper:
        """Return a stepper for `workspace` over `timetable`."""
        from mbdkit.stepping.collocation import CollocationFamily
        from mbdkit.stepping.compiled_stepper import CompiledStepper
        from mbdkit.stepping.step_control import Control

        control = None
        if self.tolerances is not None:
            control = Control(
                self.tolerances.rtol,
                self.tolerances.atol,
                order=self.tableau.order,
                estimate_order=self.tableau.stages + 1,
            )
        constrained = workspace.formulation != "index-1"
        if constrained and not (self.tableau.is_stiffly_accurate and self.stage_solver == "newton"):
            raise TableauError(
                f"{self.tableau.name} cannot serve the formulation {workspace.formulation!r}: its last stage has to be "
                "the end of the step, its matrix regular, and its stages have to be solved by Newton's method"
            )
        return CompiledStepper(CollocationFamily(self, workspace, control), workspace, timetable, control)


@dataclass(frozen=True)
class LobattoPair:
    """A partitioned Lobatto IIIA-IIIB pair in fixed steps; both constraints hold at the end of every step.

    Parameters
    ----------
    stages
        2 (RATTLE) or 3.
    tolerance
        Expected change of positions, relative to their size, at which the iteration ends; None: at stagnation.
    max_iterations
        Iterations in one step after which its equations count as unsolved.
    """

    stages: int
    tolerance: float | None = None
    max_iterations: int = 50
    carries_multipliers: ClassVar[bool] = True

    def start(self, workspace: Workspace, timetable: Timetable) -> Stepper:
        """Return a stepper for `workspace` over `timetable`."""
        from mbdkit.stepping.compiled_stepper import CompiledStepper
        from mbdkit.stepping.lobatto_iiia_iiib import PairFamily

        return CompiledStepper(PairFamily(self, workspace), workspace, timetable)


@dataclass(frozen=True)
class SciPySolver:
    """A solver class of ``scipy.integrate`` on the first-order form y = (q, v, work, dissipated).

    Parameters
    ----------
    solver
        Name of the `OdeSolver` subclass in ``scipy.integrate``, or the class itself.
    rtol, atol
        Its error tolerances.
    needs_jacobian
        Whether the solver takes the right side's Jacobian, which is then exact.
    """

    solver: str | type[Any]
    rtol: float
    atol: float
    needs_jacobian: bool = False

    def start(self, workspace: Workspace, timetable: Timetable) -> Stepper:
        """Return a stepper for `workspace` over `timetable`."""
        from mbdkit.stepping.scipy_bridge import SciPyStepper

        return SciPyStepper(self, workspace, timetable)


Method = ExplicitRungeKutta | ImplicitRungeKutta | LobattoPair | SciPySolver | StepMethod
