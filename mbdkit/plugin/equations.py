"""Equations of motion: compiled mechanisms, consistent starts, linear algebra with the same bits everywhere."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base import elementary as elementary
    from mbdkit.base.one_thread import one_thread_of_linear_algebra as one_thread_of_linear_algebra
    from mbdkit.base.quadrature import gauss_on_unit as gauss_on_unit
    from mbdkit.engine.compile_mechanism import compile_mechanism as compile_mechanism
    from mbdkit.engine.compiled_mechanism import CompiledMechanism as CompiledMechanism
    from mbdkit.engine.consistent_start import workspace_at_start as workspace_at_start
    from mbdkit.engine.force_laws import NativeLaw as NativeLaw
    from mbdkit.engine.least_change import LeastChange as LeastChange
    from mbdkit.engine.observed_states import GivenForces as GivenForces, StateObserver as StateObserver
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
