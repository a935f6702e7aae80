"""Descriptions of integration methods. The `create` function of an integrator plugin returns one of these objects.

`mbdkit.stepping.start.start_method` creates the stepper that executes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from mbdkit.methods.step_method import StepMethod
from mbdkit.methods.tableau import ButcherTableau, TableauError

if TYPE_CHECKING:
    from mbdkit.methods.embedded_estimate import EmbeddedPair


@dataclass(frozen=True)
class Tolerances:
    """Error tolerances of a method with controlled step size.

    Parameters
    ----------
    rtol, atol
        Relative, and absolute [m, rad, m/s, rad/s].
    max_step
        Largest step [s]; None: no limit.
    by_size
        Whether `atol` is the default, which applies to lengths in units of the mechanism's characteristic length if
        that is below 1 m; see `mbdkit.stepping.step_control.unit_of_length`.
    """

    rtol: float
    atol: float
    max_step: float | None = None
    by_size: bool = False


@dataclass(frozen=True)
class ExplicitRungeKutta:
    """An explicit Runge-Kutta method for the index-1 equations, with fixed or controlled step size.

    Parameters
    ----------
    pair
        Error estimates and dense output, if there are any.
    tolerances
        For a controlled step size, which requires a `pair`; None: fixed steps.
    """

    tableau: ButcherTableau
    pair: EmbeddedPair | None = None
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        if not self.tableau.is_explicit:
            raise TableauError(f"{self.tableau.name} is implicit: its stages need ImplicitRungeKutta")
        if self.tolerances is not None and self.pair is None:
            raise TableauError(f"{self.tableau.name} has no error estimate, which tolerances require")


@dataclass(frozen=True)
class ImplicitRungeKutta:
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
        Change of the stage accelerations, relative to their size, at which the iteration ends; None: at stagnation, or
        with `tolerances` at a small fraction of these.
    max_iterations
        Largest number of iterations in one step, after which the step fails; None: 50, or more for fixed steps that
        converge slowly and would fail otherwise.
    tolerances
        For a controlled step size, which requires a collocation method; None: fixed steps.
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


@dataclass(frozen=True)
class LobattoPair:
    """A partitioned Lobatto IIIA-IIIB pair with fixed steps; Phi = 0 and its derivative hold at the end of every step.

    Parameters
    ----------
    stages
        2 (RATTLE) or 3.
    tolerance
        Expected change of positions, relative to their size, at which the iteration ends; None: at stagnation.
    max_iterations
        Largest number of iterations in one step, after which the step fails; None: see `ImplicitRungeKutta`.
    """

    stages: int
    tolerance: float | None = None
    max_iterations: int | None = None
    carries_multipliers: ClassVar[bool] = True


@dataclass(frozen=True)
class SciPySolver:
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


Method = ExplicitRungeKutta | ImplicitRungeKutta | LobattoPair | SciPySolver | StepMethod
