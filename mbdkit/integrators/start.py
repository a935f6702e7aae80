"""Starts a method on a mechanism."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Never

from mbdkit.engine.compiled_mechanism import CompiledMechanism
from mbdkit.engine.formulation import FORMULATIONS
from mbdkit.engine.workspace import Workspace
from mbdkit.integrators.host.step_host import StepHost
from mbdkit.integrators.host.steps_to_changes import ToSwitches, with_changes
from mbdkit.integrators.interface import Stepper, Timetable
from mbdkit.integrators.loop.compiled_stepper import CompiledStepper
from mbdkit.integrators.loop.switches import switch_bundle
from mbdkit.integrators.run.step_control import Control, unit_of_length
from mbdkit.integrators.stages.compiled_method import CompiledMethod
from mbdkit.methods.kinds import Method, Traits
from mbdkit.methods.step_methods import ExternalMethod, StepMethod
from mbdkit.registry.seam import Seam


def step_control(traits: Traits, mechanism: CompiledMechanism) -> Control | None:
    """Return the step-size control of a method with these traits on a mechanism; None for fixed steps."""
    tolerances, local_error = traits.tolerances, traits.local_error
    if tolerances is None or local_error is None:
        return None
    return Control(
        tolerances.rtol,
        tolerances.atol,
        order=local_error.order,
        estimate_order=local_error.estimate_order,
        estimates=local_error.estimates,
        memory=local_error.memory,
        max_step=math.inf if tolerances.max_step is None else tolerances.max_step,
        length=unit_of_length(tolerances.by_size, mechanism),
        filter=tolerances.control,
    )


def compiled_method(method: Method, workspace: Workspace) -> tuple[CompiledMethod, Control | None]:
    """Return a compiled method, and its step-size control, which is None for fixed steps.

    Raises mbdkit.methods.tableau.TableauError if a tableau cannot be used with the formulation of the workspace. Raises
    mbdkit.base.errors.UnsupportedMechanismError if the method does not support the mechanism.
    """
    method.require_formulation(FORMULATIONS[workspace.formulation])
    method.require_mechanism(workspace.mechanism)
    control = step_control(method.traits, workspace.mechanism)
    assert method.traits.compiled is not None
    return method.traits.compiled()(method, workspace, control), control


#: What takes the steps of a run, or a function that makes it of a method in machine code.
Steps = StepMethod | ExternalMethod | Callable[[CompiledMethod], CompiledMethod]


@Seam
def treatment_method(method: Method, treatment: Never, /) -> Steps:
    """Return what takes the steps of a run in place of its method, with the section of the spec on the treatment.

    Its memory has the attributes of `mbdkit.integrators.run.impulse.ReactingMemory`.
    """
    raise NotImplementedError


def start_method(method: Method, workspace: Workspace, timetable: Timetable) -> Stepper:
    """Return a stepper that runs a method.

    `method`: the method, as returned by the `create` of an integrator plugin. `workspace`: the mechanism and its start,
    with formulation and stabilization. `timetable`: times of the run, and which states are recorded. Raises
    mbdkit.engine.elimination_order.SingularSystemError if the equations of the first step are singular. Raises
    mbdkit.methods.tableau.TableauError if a tableau cannot be used with the formulation of the workspace. Raises
    mbdkit.base.errors.UnsupportedMechanismError if the method does not support the mechanism.
    """
    traits, treated = method.traits, None
    chosen = next((one for one in workspace.mechanism.treatments if one.item.method is not None), None)
    if chosen is not None and chosen.item.method is not None:
        treated = treatment_method.of(chosen.item.method)(method, chosen.section)
    if traits.compiled is None:
        if chosen is None or not chosen.item.reacting:
            method.require_formulation(FORMULATIONS[workspace.formulation])
        if treated is None:
            own = method if traits.steps is None else traits.steps()(method)
            assert isinstance(own, StepMethod | ExternalMethod)
            treated = own
    if isinstance(treated, StepMethod | ExternalMethod):
        switches = None if treated.tolerances is None else switch_bundle(workspace, timetable.end - timetable.start)
        if switches is not None:
            treated = with_changes(treated, ToSwitches(switches))
        return StepHost(treated, workspace, timetable, switches)
    compiled, control = compiled_method(method, workspace)
    return CompiledStepper(compiled if treated is None else treated(compiled), workspace, timetable, control)
