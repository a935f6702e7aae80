"""Starts a method on a mechanism: one function, dispatched on the class of the method."""

from __future__ import annotations

import math
from functools import singledispatch
from typing import Any

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.workspace import Workspace
from mbdkit.methods.kinds import (
    ExplicitRungeKutta,
    ImplicitRungeKutta,
    LobattoPair,
    Method,
    SciPySolver,
    Tolerances,
)
from mbdkit.methods.step_method import StepMethod
from mbdkit.methods.tableau import TableauError
from mbdkit.stepping.collocation import CompiledCollocation
from mbdkit.stepping.compiled_stepper import CompiledStepper
from mbdkit.stepping.diagonally_implicit import DiagonallyImplicit
from mbdkit.stepping.explicit import CompiledExplicit
from mbdkit.stepping.interface import Stepper, Timetable
from mbdkit.stepping.lobatto_iiia_iiib import CompiledLobattoPair
from mbdkit.stepping.python_stepper import PythonStepper
from mbdkit.stepping.scipy_bridge import SciPyStepper
from mbdkit.stepping.step_control import Control, unit_of_length


def _control(tolerances: Tolerances, mechanism: CompiledMechanism, **parameters: Any) -> Control:
    """Return step-size control with the tolerances of a method and other `parameters` of `Control`."""
    return Control(
        tolerances.rtol,
        tolerances.atol,
        max_step=math.inf if tolerances.max_step is None else tolerances.max_step,
        length=unit_of_length(tolerances.by_size, mechanism),
        **parameters,
    )


def explicit_control(method: ExplicitRungeKutta, mechanism: CompiledMechanism) -> Control | None:
    """Return the step-size control of an explicit method on a mechanism; None for fixed steps."""
    if method.tolerances is None or method.pair is None:
        return None
    return _control(
        method.tolerances,
        mechanism,
        order=method.tableau.order,
        estimate_order=method.pair.estimate_order,
        estimates=len(method.pair.error),
        memory=0.2,
    )


def implicit_control(method: ImplicitRungeKutta, workspace: Workspace) -> Control | None:
    """Return the step-size control of a collocation method; None for fixed steps."""
    if method.tolerances is None:
        return None
    order, stages = method.tableau.order, method.tableau.stages
    return _control(method.tolerances, workspace.mechanism, order=order, estimate_order=stages + 1)


def require_stiffly_accurate(method: ImplicitRungeKutta, workspace: Workspace) -> None:
    """Raise TableauError unless a method can be used with the formulation of a workspace."""
    tableau = method.tableau
    if workspace.formulation != "index-1" and not (tableau.is_stiffly_accurate and method.stage_solver == "newton"):
        raise TableauError(
            f"{tableau.name} cannot be used with the formulation {workspace.formulation!r}, which requires a stiffly "
            "accurate tableau with a regular matrix, and the stage solver 'newton'"
        )


@singledispatch
def start_method(method: Method, workspace: Workspace, timetable: Timetable) -> Stepper:
    """Return a stepper that runs a method.

    Parameters
    ----------
    method
        The method, as returned by the `create` of an integrator plugin.
    workspace
        The mechanism and its start, with formulation and stabilization.
    timetable
        Times of the run, and which states are recorded.

    Raises
    ------
    mbdkit.engine.elimination_order.SingularSystemError
        If the equations of the first step are singular.
    mbdkit.methods.tableau.TableauError
        If a tableau cannot be used with the formulation of the workspace.
    """
    raise TypeError(f"{type(method).__name__} is not a method")


@start_method.register
def _(method: ExplicitRungeKutta, workspace: Workspace, timetable: Timetable) -> Stepper:
    control = explicit_control(method, workspace.mechanism)
    return CompiledStepper(CompiledExplicit(method, workspace), workspace, timetable, control)


@start_method.register
def _(method: ImplicitRungeKutta, workspace: Workspace, timetable: Timetable) -> Stepper:
    tableau = method.tableau
    if not tableau.is_diagonalisable:
        if workspace.formulation != "index-1":
            raise TableauError(
                f"{tableau.name} cannot be used with the formulation {workspace.formulation!r}: its stages are solved "
                "one after the other, which is implemented for index-1"
            )
        return PythonStepper(DiagonallyImplicit(method), workspace, timetable)
    require_stiffly_accurate(method, workspace)
    control = implicit_control(method, workspace)
    return CompiledStepper(CompiledCollocation(method, workspace, control), workspace, timetable, control)


@start_method.register
def _(method: LobattoPair, workspace: Workspace, timetable: Timetable) -> Stepper:
    return CompiledStepper(CompiledLobattoPair(method, workspace), workspace, timetable)


@start_method.register
def _(method: SciPySolver, workspace: Workspace, timetable: Timetable) -> Stepper:
    return SciPyStepper(method, workspace, timetable)


@start_method.register
def _(method: StepMethod, workspace: Workspace, timetable: Timetable) -> Stepper:
    return PythonStepper(method, workspace, timetable)
