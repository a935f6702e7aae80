"""CVODE and IDA of SUNDIALS for mbdkit, each as an `OdeSolver` of SciPy around scikit-sundae.

mbdkit passes to such a class the first-order form y' = f(t, y) of the index-1 equations, where y contains q, v and two
energies, and the exact Jacobian J = df/dy. CVODE uses both directly. IDA solves the residual equation y' - f(t, y) = 0,
whose iteration matrix is c I - J. SUNDIALS chooses the steps, and its interpolant gives the solution between them.
"""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.integrate import DenseOutput, OdeSolver
from sksundae.cvode import CVODE
from sksundae.ida import IDA

import mbdkit
from mbdkit.plugin import Method, SciPySolver
from mbdkit.plugin.seams import integrator_claims, integrator_method

REFERENCES = tuple(Path(__file__).with_name("references.bib").read_text(encoding="utf-8").strip().split("\n\n"))

Rates = Callable[[float, np.ndarray], np.ndarray]


class SundialsOptions(BaseModel):
    """Tolerances and largest order."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", use_attribute_docstrings=True)

    rtol: Annotated[float, Field(ge=1e-15, lt=1, allow_inf_nan=False)] = 1e-8
    """Relative error tolerance of a step."""
    atol: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1e-10
    """Absolute error tolerance of a step [m, rad, m/s, rad/s]."""
    max_order: Annotated[int, Field(ge=1, le=5)] = 5
    """Highest order of the backward differentiation formulas."""


class CvodeOptions(SundialsOptions):
    """Tolerances, largest order, and family of formulas."""

    family: Literal["BDF", "Adams"] = "BDF"
    """`BDF` for stiff springs and dampers; otherwise `Adams`, whose order is 1 to 12 regardless of `max_order`."""


class Interpolant(DenseOutput):  # type: ignore[misc]
    """Interpolant of SUNDIALS over the last step. It is valid until the next step is taken."""

    def __init__(self, t_old: float, t: float, solver: Any):
        super().__init__(t_old, t)
        self.solver = solver

    def _call_impl(self, t: np.ndarray) -> np.ndarray:
        results = [np.array(self.solver.step(float(x), "normal").y) for x in np.atleast_1d(t)]
        self.solver.step(self.t, "normal")  # otherwise the next step would repeat this one
        return np.stack(results, axis=-1) if np.ndim(t) else results[0]


class SundialsSolver(OdeSolver, ABC):  # type: ignore[misc]
    """A solver of SUNDIALS that takes one step at a time; subclasses create the solver."""

    t: float
    y: np.ndarray

    def __init__(self, fun: Rates, t0: float, y0: np.ndarray, t_bound: float, *, jac: Rates, **options: Any):
        super().__init__(fun, t0, y0, t_bound, vectorized=False)
        self.jac = jac
        self.solver = self.new_solver(options)
        self.start(y0)

    @abstractmethod
    def new_solver(self, options: dict[str, Any]) -> Any:
        """Return the SUNDIALS solver with the given tolerances, first step, order and formulas."""

    def start(self, y0: np.ndarray) -> None:
        """Pass the initial values to the solver."""
        self.solver.init_step(self.t, y0)

    def _step_impl(self) -> tuple[bool, str | None]:
        with redirect_stdout(io.StringIO()):  # scikit-sundae prints its message in addition to returning it
            result = self.solver.step(self.t_bound, "onestep", self.t_bound)
        if not result.success:
            return False, str(result.message)
        if result.t - self.t < 10 * np.spacing(self.t):  # otherwise SUNDIALS would continue with ever smaller steps
            return False, self.TOO_SMALL_STEP
        self.t, self.y = float(result.t), np.array(result.y)
        self.njev, self.nlu = int(result.njev), int(result.njev)
        return True, None

    def _dense_output_impl(self) -> Interpolant:
        return Interpolant(self.t_old, self.t, self.solver)


class Cvode(SundialsSolver):
    """CVODE applied to y' = f(t, y)."""

    def new_solver(self, options: dict[str, Any]) -> Any:
        """Return a CVODE solver for f and its Jacobian."""

        def rates(t: float, y: np.ndarray, out: np.ndarray) -> None:
            out[:] = self.fun(t, y)

        def jacobian(t: float, y: np.ndarray, yp: np.ndarray, out: np.ndarray) -> None:
            out[:] = self.jac(t, y)

        return CVODE(rates, jacfn=jacobian, **options)


class Ida(SundialsSolver):
    """IDA applied to y' - f(t, y) = 0."""

    def new_solver(self, options: dict[str, Any]) -> Any:
        """Return an IDA solver for the residual and its iteration matrix."""

        def residual(t: float, y: np.ndarray, yp: np.ndarray, out: np.ndarray) -> None:
            out[:] = yp - self.fun(t, y)

        def matrix(t: float, y: np.ndarray, yp: np.ndarray, res: np.ndarray, c: float, out: np.ndarray) -> None:
            out[:] = c * np.eye(len(y)) - self.jac(t, y)

        return IDA(residual, jacfn=matrix, **options)

    def start(self, y0: np.ndarray) -> None:
        """Pass the initial values and rates to the solver."""
        self.solver.init_step(self.t, y0, self.fun(self.t, y0))


def _create(solver: type[SundialsSolver]) -> Callable[[SundialsOptions], Method]:
    @integrator_method
    def create(chosen: SundialsOptions) -> SciPySolver:
        family: dict[str, Any] = {"method": chosen.family} if isinstance(chosen, CvodeOptions) else {}
        order: dict[str, Any] = {"max_order": chosen.max_order} if family.get("method") != "Adams" else {}
        configured: Any = partial(solver, **family, **order)
        return SciPySolver(configured, chosen.rtol, chosen.atol, needs_jacobian=True)

    return create


create_cvode, create_ida = _create(Cvode), _create(Ida)


@integrator_claims
def claims(chosen: SundialsOptions) -> mbdkit.Claims:
    """Return the claims of both solvers."""
    return mbdkit.Claims(
        adaptive=True,
        drift="constraints hold at acceleration level only: drift follows the tolerance and grows with time",
        needs=("accelerations", "tangents"),
        stabilizations=("none", "baumgarte"),
        states=True,
        variable_order=True,
        restartable=False,
    )
