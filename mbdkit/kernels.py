"""What authors of machine code import: bundles, kinds of kernels, status codes, solvers, elementary functions."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.engine.kernels.accelerations import (
        apply_multipliers as apply_multipliers, joint_right_side as joint_right_side,
        refine_multipliers as refine_multipliers, solve_accelerations as solve_accelerations,
        solve_system as solve_system, substitute_by_pivots as substitute_by_pivots,
        substitute_by_schur as substitute_by_schur,
    )
    from mbdkit.engine.kernels.angles import cosine_and_sine as cosine_and_sine
    from mbdkit.engine.kernels.applied_forces import (
        BODY_FORCE as BODY_FORCE, PATHWAYS as PATHWAYS, POINT_FORCE as POINT_FORCE, TORQUE as TORQUE,
        any_forces as any_forces, applied_forces as applied_forces, take_multipliers as take_multipliers,
        take_states as take_states,
    )
    from mbdkit.engine.kernels.bundle_types import (
        ComplexMatrix as ComplexMatrix, ComplexVector as ComplexVector, IntMatrix as IntMatrix, IntVector as IntVector,
        RealCube as RealCube, RealMatrix as RealMatrix, RealVector as RealVector, STATE as STATE, State as State,
        example_of as example_of, kept as kept,
    )
    from mbdkit.engine.friction_forces import PIN as PIN, SLIDE as SLIDE
    from mbdkit.engine.kernels.dual_observe import (
        DualStates as DualStates, describe_duals as describe_duals, observe_duals as observe_duals,
    )
    from mbdkit.engine.kernels.dual_system import new_dual_solver as new_dual_solver
    from mbdkit.engine.kernels.elementary import FUNCTIONS as FUNCTIONS
    from mbdkit.engine.kernels.elementary.exact_sums import bits_of as bits_of, from_bits as from_bits
    from mbdkit.engine.kernels.engine_bundles import Topology as Topology, load_engine as load_engine
    from mbdkit.engine.kernels.equations import (
        DAMPING as DAMPING, GAMMA_V as GAMMA_V, JACOBIAN as JACOBIAN, MASS as MASS, STIFFNESS as STIFFNESS,
    )
    from mbdkit.engine.kernels.filters import filter_rows as filter_rows
    from mbdkit.engine.kernels.frames import (
        Frames as Frames, Reactions as Reactions, evaluate_frames as evaluate_frames,
        reactions_in_frames as reactions_in_frames,
    )
    from mbdkit.engine.kernels.interpolation import fade as fade, hermite as hermite
    from mbdkit.engine.kernels.law_programs import OPCODES as OPCODES
    from mbdkit.engine.kernels.lu import (
        Factors as Factors, Pattern as Pattern, factorize as factorize, solve_refined as solve_refined,
        substitute as substitute,
    )
    from mbdkit.engine.kernels.motions import motions_at as motions_at
    from mbdkit.engine.kernels.observe import (
        Observed as Observed, constraints_at as constraints_at, tangents_at as tangents_at,
    )
    from mbdkit.engine.kernels.orthogonal import (
        reduce_columns as reduce_columns, solve_least_norm as solve_least_norm, solve_triangle as solve_triangle,
    )
    from mbdkit.engine.kernels.projection import (
        EPS as EPS, FEW_ROUNDINGS as FEW_ROUNDINGS, MOST_ITERATIONS as MOST_ITERATIONS, STAGNANT as STAGNANT,
        largest_size as largest_size, position_rows as position_rows, project_velocities as project_velocities,
        rate_rows as rate_rows, scaled_residual as scaled_residual,
    )
    from mbdkit.engine.kernels.schur import solve as solve
    from mbdkit.engine.kernels.system import (
        DIVERGED as DIVERGED, NOT_FINITE as NOT_FINITE, OK as OK, REPIVOT_STAGES as REPIVOT_STAGES,
        evaluate_powers as evaluate_powers, evaluate_tangents as evaluate_tangents, fold_values as fold_values,
        prepare_angles as prepare_angles, solved_rows as solved_rows, unfold_multipliers as unfold_multipliers,
    )
    from mbdkit.engine.kernels.table_rows import (
        BODIES as BODIES, COUPLING as COUPLING, INPUT as INPUT, INTERACTION as INTERACTION, JOINT as JOINT,
        LAW_ROW as LAW_ROW, LINEAR as LINEAR, LOAD as LOAD, LOAD_VALUE as LOAD_VALUE, LawRow as LawRow,
        MULTIPLIER as MULTIPLIER, PAIR as PAIR, SECTION as SECTION, SLOPE as SLOPE, SPARE as SPARE, SPRING as SPRING,
        STATE_ROW as STATE_ROW, STATE_USE as STATE_USE, TENSION as TENSION,
    )
    from mbdkit.engine.kernels.tree import (
        BODY as BODY, PLACE as PLACE, PLACE_SIDE as PLACE_SIDE, TURN as TURN,
        accelerate_coordinates as accelerate_coordinates, coordinates_of as coordinates_of,
        place_bodies as place_bodies, turned as turned,
    )
    from mbdkit.engine.kernels.tree_displacements import accelerate_bodies as accelerate_bodies
    from mbdkit.engine.kernels.vectors import (
        copy as copy, fill as fill, fill_rows as fill_rows, stays_finite as stays_finite,
    )
    from mbdkit.engine.native import arithmetic as arithmetic, calls as calls, machine_code as machine_code
    from mbdkit.engine.native.arithmetic import (
        DIRECTIONS as DIRECTIONS, any_of as any_of, value_of as value_of, where as where,
    )
    from mbdkit.engine.native.bundle import PinnedBundle as PinnedBundle, bundle_loader as bundle_loader
    from mbdkit.engine.native.calls import (
        LAW as LAW, call_entry as call_entry, call_law as call_law, integers_at as integers_at,
        new_registers as new_registers, numbers_at as numbers_at,
    )
    from mbdkit.engine.native.functions import (
        DECLARED as DECLARED, entry as entry, inlined as inlined, kernel as kernel, law_function as law_function,
        separate as separate, subkernel as subkernel,
    )
    from mbdkit.engine.native.kernel import Entry as Entry, Kernel as Kernel, LawFunction as LawFunction
    from mbdkit.engine.native.levels import (
        Level as Level, PLATFORMS as PLATFORMS, Platform as Platform, WIDTH as WIDTH, chosen_level as chosen_level,
        this_platform as this_platform,
    )
    from mbdkit.engine.native.number_arrays import (
        ComplexDuals as ComplexDuals, ComplexLanes as ComplexLanes, Duals as Duals, ITEM as ITEM, Lanes as Lanes,
        new_duals as new_duals, new_lanes as new_lanes,
    )
    from mbdkit.integrators.duals.dual_loop import drive_explicit_duals as drive_explicit_duals
    from mbdkit.integrators.stages.collocation_stages import load_stages as load_stages
    from mbdkit.integrators.lanes.lane_collocation import (
        StagePivoting as StagePivoting, StagePivots as StagePivots, load_stage_pivots as load_stage_pivots,
    )
    from mbdkit.integrators.lanes.lane_control import (
        ENDED as ENDED, accelerate as accelerate, new_lane_control as new_lane_control,
    )
    from mbdkit.integrators.lanes.lane_mechanisms import (
        fill_lane as fill_lane, suits_lanes as suits_lanes, topology_of as topology_of,
    )
    from mbdkit.integrators.lanes.lane_run import new_lane_run as new_lane_run
    from mbdkit.integrators.stages.explicit import CompiledExplicit as CompiledExplicit
    from mbdkit.integrators.stages.relative import (
        BASE as BASE, BASE_RATES as BASE_RATES, Relative as Relative, V_STAGE as V_STAGE, Y as Y,
        end_of_step as end_of_step, new_relative as new_relative,
    )
    from mbdkit.integrators.run.run_state import (
        AT_END_OF_LAST as AT_END_OF_LAST, AT_START_OF_LAST as AT_START_OF_LAST, FACTORIZATIONS as FACTORIZATIONS,
        ITERATIONS as ITERATIONS, JACOBIANS as JACOBIANS, MODIFIED as MODIFIED, PROJECTIONS as PROJECTIONS, RHS as RHS,
        RunState as RunState, keep_node as keep_node, load_run_state as load_run_state,
    )
    from mbdkit.integrators.run.step_guards import begin_energy as begin_energy, new_guard_state as new_guard_state
    from mbdkit.integrators.loop.step_loop import PAUSED as PAUSED, REFUSED as REFUSED, SHORTER as SHORTER
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
