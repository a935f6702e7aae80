"""Frames in which a body stands on the ground beside the plates, so that a force of the ground is not measured."""

from __future__ import annotations

import numpy as np

from mbdkit.base import elementary
from mbdkit_biomech.inverse_dynamics.compute import Inverse
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import centre_of_pressure, in_body

#: A body stands on the ground if an end of the points at which plates act on it moves more slowly [m/s] and is less
#: above the ground [m] for a longer time [s]; the ground also acts for this time before and after, while the body is
#: faster. In swing, heel and toe pass 10 to 20 mm above the ground with more than 1 m/s.
SLOW, LOW, CONTACT = 0.5, 0.05, 0.1

ENDS = 0.05, 0.95  #: Quantiles of these points along the body that are their ends.


def unmeasured_frames(result: Inverse) -> dict[str, np.ndarray]:
    """Return the frames (T,) in which bodies stand on the ground without a measured force, by body, for those that do.
    A contact that the spec declares counts whenever no load acts on its body.
    """
    problem, loads = result.problem, result.loads
    names, acts = list(problem.fitter.bodies), np.any(loads.force != 0, axis=2)
    values: dict[str, np.ndarray] = {}
    for body in dict.fromkeys((*problem.spec.unmeasured, *loads.bodies)):
        indexes = [index for index, on in enumerate(loads.bodies) if on == body]
        free = ~np.any(acts[:, indexes], axis=1)
        stated = problem.spec.loads  # not those of bodies that follow the motion
        plates = [i for i in indexes if loads.names[i] in stated and stated[loads.names[i]].is_plate]
        if body not in problem.spec.unmeasured:
            if not plates or not np.any(acts[:, plates]):
                continue
            free &= _around(result.motion.time, free & _stands(result, names.index(body), plates, acts))
        if free.any():
            values[body] = free
    return values


def _stands(result: Inverse, body: int, plates: list[int], acts: np.ndarray) -> np.ndarray:
    """Return whether a body is close to the ground and slow at an end of the points of its plates, (T,)."""
    q, v = (x[:, 3 * body : 3 * body + 3] for x in (result.motion.q, result.motion.v))
    points = [centre_of_pressure(result, index)[0] for index in plates]
    own = np.concatenate([in_body(result, x, body)[acts[:, k]] for x, k in zip(points, plates, strict=True)])
    ground = np.median(np.concatenate([x[acts[:, k], 1] for x, k in zip(points, plates, strict=True)]))
    c, s = elementary.cos(q[:, 2]), elementary.sin(q[:, 2])
    stands = np.zeros(len(q), dtype=bool)
    for share in ENDS:
        x, y = float(np.quantile(own[:, 0], share)), float(np.median(own[:, 1]))
        arm = np.stack([c * x - s * y, s * x + c * y], axis=1)
        speed = np.hypot(v[:, 0] - v[:, 2] * arm[:, 1] + result.problem.spec.motion.belt, v[:, 1] + v[:, 2] * arm[:, 0])
        stands |= (speed < SLOW) & (q[:, 1] + arm[:, 1] - ground < LOW)
    return stands


def _around(time: np.ndarray, stands: np.ndarray) -> np.ndarray:
    """Return the frames (T,) of contacts that are not too short, and those around them."""
    values = np.zeros(len(time), dtype=bool)
    for first, end in np.flatnonzero(np.diff(np.concatenate([[False], stands, [False]]))).reshape(-1, 2).tolist():
        if time[end - 1] - time[first] >= CONTACT:
            values |= (time >= time[first] - CONTACT) & (time <= time[end - 1] + CONTACT)
    return values
