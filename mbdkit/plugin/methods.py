"""Integration methods from inside: steppers, timetables, dense output, guards."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.base.quadrature import lagrange as lagrange
    from mbdkit.integrators.stages.stage_polynomials import collocation_polynomials as collocation_polynomials
    from mbdkit.methods.method_options import ControlledOptions as ControlledOptions
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
