"""What authors of machine code import: bundles, kinds of kernels, status codes, solvers, elementary functions."""

from typing import TYPE_CHECKING

from mbdkit.base.lazy_names import door

if TYPE_CHECKING:  # `door` imports these when first used; an alias exports a name for type checkers
    # fmt: off
    from mbdkit.engine.kernels.elementary import FUNCTIONS as FUNCTIONS
    from mbdkit.engine.kernels.frames import Frames as Frames, evaluate_frames as evaluate_frames
    from mbdkit.engine.kernels.observe import Observed as Observed
    from mbdkit.engine.native.arithmetic import value_of as value_of
    from mbdkit.engine.native.calls import numbers_at as numbers_at
    from mbdkit.engine.native.functions import (
        inlined as inlined, kernel as kernel, law_function as law_function, subkernel as subkernel,
    )
    # fmt: on
else:
    __getattr__, __dir__ = door(globals())
