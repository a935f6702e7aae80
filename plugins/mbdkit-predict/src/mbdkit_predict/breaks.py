"""Times at which tables, motions and expressions of a prediction are discontinuous, or one of their derivatives is."""

from __future__ import annotations

import math

from mbdkit.events.state_program import state_program
from mbdkit.mechanism.motion_corners import corners_of
from mbdkit.mechanism.switching_times import switching_times
from mbdkit_predict.predict_spec import PredictSpec

#: If there are more of them, such as the points of a measured table with linear interpolation, none is returned.
MOST = 100


def breaks_of(spec: PredictSpec, end: float) -> list[float]:
    """Return the times between 0 and `end` [s] at which the value, the rate or the acceleration of a table or an
    expression of time jumps, and those at which ``abs``, ``min`` or ``max`` of time switch in an expression of the
    state.
    """
    mechanism = spec.mechanism()
    motions = [*(motion for _, motion in mechanism.motions()), *spec.tables.values()]
    times = {corner.time for motion in motions for corner in corners_of(motion, 0.0, end) if not corner.is_smooth}
    for _, text in mechanism.expressions():
        # quantities are unknown numbers here, so that switches that depend on them are left out
        program, _ = state_program(text, mechanism)
        program = tuple(("const", math.nan) if name == "get" else (name, x) for name, x in program)
        times |= {time for time, _ in switching_times(program, 0.0, end)}
    inside = sorted(time for time in times if 0.0 < time < end)
    return inside if len(inside) <= MOST else []
