"""Gradients: exact derivatives of measures with respect to parameters of the model, with a check by differences.

This module is a door: the names that other parts import from `mbdkit_gradients`, each imported when it is first used.
"""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    from mbdkit_gradients.gradient_parameters import resolved as resolved
    from mbdkit_gradients.measure_gradients import Gradient as Gradient
    from mbdkit_gradients.measure_gradients import gradient as gradient
    from mbdkit_gradients.measure_gradients import gradients_at as gradients_at
else:
    __getattr__, __dir__ = door(globals())
