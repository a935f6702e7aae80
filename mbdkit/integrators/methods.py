"""What an integrator plugin's `create` returns: the method as data, and the stepper that it starts.

A method says how it is stepped: `start` takes a `mbdkit.engine.problem.Problem` and returns an object that the
simulation advances. Heavy modules are imported there, not here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from mbdkit.integrators.step_method import StepMethod
from mbdkit.integrators.tableau import ButcherTableau, TableauError

if TYPE_CHECKING:
    from mbdkit.engine.problem import Problem
    from mbdkit.integrators.stepping import Stepper, Timetable


@dataclass(frozen=True)
class ExplicitRungeKutta:
    """An explicit Runge-Kutta method in fixed steps, on the index-1 equations."""

    tableau: ButcherTableau

    def __post_init__(self) -> None:
        if not self.tableau.is_explicit:
            raise TableauError(f"{self.tableau.name} is implicit: its stages need ImplicitRungeKutta")

    def start(self, problem: Problem, timetable: Timetable) -> Stepper:
        """Return a stepper for `problem` over `timetable`."""
        from mbdkit.integrators.explicit import ExplicitStepper

        return ExplicitStepper(self, problem, timetable)


@dataclass(frozen=True)
class ImplicitRungeKutta:
    """A fully implicit Runge-Kutta method in fixed steps, stages solved in second-order form.

    Parameters
    ----------
    tableau
        Its coefficients; ``a`` must be diagonalisable.
    stage_solver
        Simplified Newton on accelerations and multipliers, or fixed-point iteration on accelerations.
    tolerance
        Change of the stage accelerations, relative to their size, at which the iteration ends; None: at stagnation.
    max_iterations
        Iterations in one step after which the stage equations count as unsolved.
    """

    tableau: ButcherTableau
    stage_solver: Literal["newton", "fixed-point"] = "newton"
    tolerance: float | None = None
    max_iterations: int = 50

    def __post_init__(self) -> None:
        if not self.tableau.is_diagonalisable:
            raise TableauError(
                f"the matrix of {self.tableau.name} cannot be diagonalised, which the transformed stage equations need"
            )

    def start(self, problem: Problem, timetable: Timetable) -> Stepper:
        """Return a stepper for `problem` over `timetable`."""
        from mbdkit.integrators.implicit import ImplicitStepper

        return ImplicitStepper(self, problem, timetable)


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

    def start(self, problem: Problem, timetable: Timetable) -> Stepper:
        """Return a stepper for `problem` over `timetable`."""
        from mbdkit.integrators.scipy_bridge import SciPyStepper

        return SciPyStepper(self, problem, timetable)


Method = ExplicitRungeKutta | ImplicitRungeKutta | SciPySolver | StepMethod
