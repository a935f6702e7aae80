"""Integration methods from inside: steppers, timetables, dense output, guards."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.integrators.stages.compiled_method import CompiledMethod as CompiledMethod
    from mbdkit.integrators.loop.compiled_stepper import CompiledStepper as CompiledStepper
    from mbdkit.integrators.duals.dual_run import (
        DualRun as DualRun, NO_SEEDS as NO_SEEDS, Seeds as Seeds, constants as constants, dual_states as dual_states,
        new_dual_run as new_dual_run,
    )
    from mbdkit.integrators.run.impulse import ElementImpact as ElementImpact, ReactingMemory as ReactingMemory
    from mbdkit.integrators.interface import (
        Guards as Guards, Moment as Moment, Nodes as Nodes, SAME_INSTANT as SAME_INSTANT, SAME_TIME as SAME_TIME,
        StepEvidence as StepEvidence, StepTaken as StepTaken, Stepper as Stepper, Stretch as Stretch,
        Timetable as Timetable, joined as joined,
    )
    from mbdkit.integrators.run.run_plan import guard_limits as guard_limits
    from mbdkit.integrators.run.sampled_control import Sampler as Sampler, states_at_start as states_at_start
    from mbdkit.integrators.stages.stage_polynomials import collocation_polynomials as collocation_polynomials
    from mbdkit.integrators.start import start_method as start_method
    from mbdkit.integrators.run.step_control import Control as Control
    from mbdkit.methods.kinds import LocalError as LocalError
    from mbdkit.methods.method_options import ControlledOptions as ControlledOptions
    from mbdkit.methods.step_methods import Dense as Dense
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
