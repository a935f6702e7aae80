"""Methods whose steps have derivatives by parameters, prepared for a run that is differentiated."""

from __future__ import annotations

from mbdkit.engine.stabilization import Stabilization
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import ExplicitRungeKutta, ImplicitRungeKutta, Method
from mbdkit.stepping.collocation import CompiledCollocation
from mbdkit.stepping.differentiated_stepper import NoDerivativeError
from mbdkit.stepping.explicit import CompiledExplicit
from mbdkit.stepping.start import explicit_control, implicit_control, require_stiffly_accurate
from mbdkit.stepping.step_control import Control

WITHOUT_DERIVATIVES = (
    "steps of explicit Runge-Kutta methods and of collocation methods (gauss, radau-iia) have derivatives; methods of "
    "SciPy, methods in Python and Lobatto pairs have none"
)


def require_derivatives(method: Method, stabilization: Stabilization) -> None:
    """Raise NoDerivativeError unless the steps of a method can be differentiated."""
    if not (
        isinstance(method, ExplicitRungeKutta)
        or (isinstance(method, ImplicitRungeKutta) and method.tableau.is_diagonalisable)
    ):
        raise NoDerivativeError(WITHOUT_DERIVATIVES)
    if stabilization.symmetric:
        raise NoDerivativeError("symmetric projections are not differentiated; use `stabilization: projection` or none")


def compiled_for_derivatives(
    method: Method, workspace: Workspace
) -> tuple[CompiledExplicit | CompiledCollocation, Control | None]:
    """Return a method whose steps can be differentiated, and its step-size control, which is None for fixed steps.

    Raises
    ------
    NoDerivativeError
        If the steps of the method cannot be differentiated.
    """
    require_derivatives(method, workspace.stabilization)
    if isinstance(method, ExplicitRungeKutta):
        return CompiledExplicit(method, workspace), explicit_control(method, workspace.mechanism)
    assert isinstance(method, ImplicitRungeKutta)
    require_stiffly_accurate(method, workspace)
    control = implicit_control(method, workspace)
    return CompiledCollocation(method, workspace, control), control
