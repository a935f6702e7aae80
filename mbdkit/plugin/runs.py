"""Runs: preparation, simulation, continuous motion, provenance."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base.called_functions import calls_allowed as calls_allowed, may_call as may_call
    from mbdkit.base.use_lock import UseLock as UseLock, one_thread_at_a_time as one_thread_at_a_time
    from mbdkit.runs.assembled_mechanism import AssembledMechanism as AssembledMechanism
    from mbdkit.runs.continuous_motion import (
        EQUAL as EQUAL, MotionPart as MotionPart, Peak as Peak, Sampled as Sampled, sampled as sampled,
    )
    from mbdkit.runs.integrals import RunIntegrals as RunIntegrals, functionals_of as functionals_of
    from mbdkit.runs.corners import knots_of as knots_of
    from mbdkit.runs.followers import AddedForces as AddedForces, Follower as Follower
    from mbdkit.runs.given_start import GivenStart as GivenStart, spec_started_at as spec_started_at
    from mbdkit.runs.finish import run_in_memory as run_in_memory
    from mbdkit.runs.preparation import (
        build as build, caution as caution, check_calls as check_calls, guards as guards, make_method as make_method,
        recorded_arrays as recorded_arrays, require_support as require_support, size_at_start as size_at_start,
        timetable as timetable,
    )
    from mbdkit.runs.provenance import model_provenance as model_provenance
    from mbdkit.runs.recorded_states import recorded_states as recorded_states
    from mbdkit.runs.recorder import shared_forces as shared_forces
    from mbdkit.runs.simulation_batch import SimulationBatch as SimulationBatch, why_not_batched as why_not_batched
    from mbdkit.runs.simulation import measured_in as measured_in, simulate_arrays as simulate_arrays
    from mbdkit.runs.step_interpolation import StepEnds as StepEnds, over_single_steps as over_single_steps
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
