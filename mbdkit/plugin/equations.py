"""Equations of motion: compiled mechanisms, consistent starts, linear algebra with the same bits everywhere."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base import elementary as elementary
    from mbdkit.base.lazy_names import homes_of as homes_of
    from mbdkit.base.one_thread import one_thread_of_linear_algebra as one_thread_of_linear_algebra
    from mbdkit.base.quadrature import gauss_legendre as gauss_legendre, gauss_on_unit as gauss_on_unit
    from mbdkit.engine.assembly import AssembledState as AssembledState
    from mbdkit.engine.compile_mechanism import compile_mechanism as compile_mechanism
    from mbdkit.engine.compiled_mechanism import CompiledMechanism as CompiledMechanism, with_ground as with_ground
    from mbdkit.engine.consistent_start import (
        MechanismAtStart as MechanismAtStart, Starts as Starts, workspace_at_start as workspace_at_start,
    )
    from mbdkit.engine.counters import Counters as Counters
    from mbdkit.engine.elimination_order import (
        SingularSystemError as SingularSystemError, empty_pattern as empty_pattern, new_factors as new_factors,
    )
    from mbdkit.engine.force_laws import (
        CompiledLaw as CompiledLaw, NativeLaw as NativeLaw, bind_law as bind_law, native_law as native_law,
    )
    from mbdkit.engine.formulation import FORMULATIONS as FORMULATIONS, Formulation as Formulation, INDEX_1 as INDEX_1
    from mbdkit.engine.input_schedule import start_settings as start_settings
    from mbdkit.engine.joint_sums import JointSums as JointSums, joint_sums as joint_sums
    from mbdkit.engine.least_change import LeastChange as LeastChange
    from mbdkit.engine.linear_systems import (
        SparseFactors as SparseFactors, factors_of as factors_of, inverse_of as inverse_of, product as product,
    )
    from mbdkit.engine.observed_states import GivenForces as GivenForces, StateObserver as StateObserver
    from mbdkit.engine.spanning_tree import is_tree_of_pins as is_tree_of_pins, spanning_tree as spanning_tree
    from mbdkit.engine.stabilization import NONE as NONE, Stabilization as Stabilization
    from mbdkit.engine.stored_arrays import fill as fill, pattern_of as pattern_of, stored as stored
    from mbdkit.engine.workspace import Workspace as Workspace
    from mbdkit.engine.linear_systems import symmetric_eigenvectors as symmetric_eigenvectors
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
