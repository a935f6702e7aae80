"""Gradients: exact derivatives of measures with respect to parameters of the model, with a check by differences.

This module is a door: the names that authors of fits and optimizations import, from `mbdkit_gradients`. Each is
imported when it is first used.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit_gradients.sensitivities import PreparedSensitivities as PreparedSensitivities, is_smooth as is_smooth
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
