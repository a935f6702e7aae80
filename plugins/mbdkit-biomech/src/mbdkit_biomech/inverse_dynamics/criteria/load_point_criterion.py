"""Criteria of the verdict on where loads act: their points of application, and contacts beside the plates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbdkit.base import elementary
from mbdkit.base.text import listed
from mbdkit.base.units import read_unit
from mbdkit.mechanism.bodies import GROUND
from mbdkit.mechanism.mechanism_quantities import Point
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.doubt import TO_DEVIATION, doubt, doubts
from mbdkit_biomech.inverse_dynamics.criteria.glitch_criterion import spans
from mbdkit_biomech.inverse_dynamics.files.measured_table import cited
from mbdkit_biomech.inverse_dynamics.loads.loads import UNLOADED_SHARE

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
    own = np.concatenate([in_body(q, x)[acts[:, k]] for x, k in zip(points, plates, strict=True)])
    ground = np.median(np.concatenate([x[acts[:, k], 1] for x, k in zip(points, plates, strict=True)]))
    stands = np.zeros(len(q), dtype=bool)
    for share in ENDS:
        x, y = float(np.quantile(own[:, 0], share)), float(np.median(own[:, 1]))
        arm = np.column_stack(Point(body, x, y).arm(result.motion.q))
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


#: A point of application is implausible if its distance from the outline of the body on which the load acts exceeds
#: this share of the extent of the body.
OUTSIDE = 0.25

OFTEN = 0.1  #: Share of the force, summed over time, that must act outside the outline to cause a doubt.

#: A load seems to act on another body if, for at least the share `ON_OTHER` of its force, its point is within `NEAR`
#: times the extent of that body from the narrow outline of that body, and farther from that of its own body by more
#: than `FARTHER` times this extent.
#:
#: In 150 loads of 90 clean data sets drawn at random, this share is at most 0.84. If these loads are given to a
#: neighbour of their body, it exceeds 0.9 in more than half of them.
ON_OTHER, NEAR, FARTHER = 0.9, 0.1, 0.03

#: Points of a plate that are declared in a smaller unit look like metres if no coordinate exceeds this value [m], and
#: if the same numbers in metres are on the body.
LEAST_POINT = 0.005

#: Each body is assumed to extend from its centre of mass by at least this multiple of its radius of gyration.
#:
#: The value is that of a uniform rod: half its length, divided by its radius of gyration.
ROD = np.sqrt(3.0)

#: The narrow outline of a body is not widened to the length of the rod if joints and markers extend over at least this
#: share of the length along x or y. A shank between its knee and its ankle is thus not as wide as it is long.
COVERED = 0.8


#: Coordinates of a point that are exactly zero under load were lost if their second difference, where they become zero,
#: exceeds `LOST` times the median second difference, and `STEPS` times the smallest change, so that rounded values may
#: cross zero. They were also lost if all of them are zero, although the body moves across the point by more than
#: `TRAVELS` times its extent.
LOST, STEPS, TRAVELS = 8 * TO_DEVIATION, 5.0, 0.1


def load_point_doubts(result: Inverse) -> Iterator[Finding]:
    """Yield a doubt for each load that acts outside of its body, or on another body."""
    wide, narrow = _outlines(result)
    for index, (name, load) in enumerate(result.problem.spec.loads.items()):
        moves = load.point is not None and not all(isinstance(x, float) for x in load.point)
        examined = load.kind == "plate" or (moves and load.kind != "other")
        if examined and np.any(result.loads.force[:, index]):
            outside = list(_outside_of_body(result, index, name, wide))
            yield from doubts("load-point", outside or _on_other_body(result, index, name, narrow))
            yield from doubts("units", _metres(result, index, name, wide))
            yield from doubts("constant", _zeros(result, index, name, wide))


def _outlines(result: Inverse) -> np.ndarray:
    """Return the wide and the narrow outlines of all bodies, (2, B, 2, 2): their smallest and largest x and y in the
    frame of the body.

    An outline contains the joint points and markers of the body. Wide outlines, and narrow ones unless these points
    cover the rod (`COVERED`), also contain a square around the centre of mass; see `ROD`.
    """
    mechanism = result.problem.names.mechanism
    places = [place[1:] for joint in mechanism.joints.values() for place in joint.attachments()]
    places += [(marker.body, marker.point) for marker in mechanism.markers.values() if marker.point is not None]
    outlines = []
    for name, body in mechanism.bodies.items():
        half = ROD * np.sqrt((body.inertia or 0.0) / body.mass)
        own = np.array([point for on, point in places if on == name]).reshape(-1, 2)
        every = np.array([(-half, -half), (half, half), *own])
        covered = own.size and np.max(np.ptp(own, axis=0)) >= COVERED * 2 * half
        outlines.append([(one.min(axis=0), one.max(axis=0)) for one in (every, own if covered else every)])
    return np.array(outlines).swapaxes(0, 1)


def centre_of_pressure(result: Inverse, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the point (T, 2) at which a load acts without its free torque, and the shift (T,) by the torque [m].

    The point is that of the load, shifted perpendicular to the force until the moment of the force includes the torque.
    """
    force, torque = result.loads.force[:, index], result.loads.torque[:, index]
    square = np.sum(force**2, axis=1)
    arm = np.divide(torque, square, out=np.zeros_like(torque), where=square > 0)
    return result.loads.point[:, index] + arm[:, None] * force[:, ::-1] * [1.0, -1.0], np.abs(arm) * np.sqrt(square)


def in_body(q: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return points (T, 2) in the frame of a body with poses (T, 3)."""
    (x, y), c, s = (point - q[:, :2]).T, elementary.cos(q[:, 2]), elementary.sin(q[:, 2])
    return np.stack([c * x + s * y, c * y - s * x], axis=1)


def _outside(result: Inverse, point: np.ndarray, body: int, outline: np.ndarray) -> np.ndarray:
    """Return the distance (T,) of points (T, 2) from the outline of a body, relative to the body's extent."""
    own = in_body(result.motion.q[:, 3 * body : 3 * body + 3], point)
    beyond = np.maximum(0.0, np.maximum(outline[0] - own, own - outline[1]))
    extent = float(np.linalg.norm(outline[1] - outline[0]))
    return np.asarray(np.linalg.norm(beyond, axis=1) / extent) if extent > 0 else np.zeros(len(own))


def _share_outside(result: Inverse, index: int, point: np.ndarray, outlines: np.ndarray) -> float:
    """Return the share of the force of a load that acts far from its body if its points are those given (T, 2)."""
    size, body = np.linalg.norm(result.loads.force[:, index], axis=1), list(result.problem.loads.values())[index].body
    return float(np.sum(size[_outside(result, point, body, outlines[body]) > OUTSIDE]) / np.sum(size))


def _outside_of_body(result: Inverse, index: int, name: str, outlines: np.ndarray) -> Iterator[str]:
    series, size = result.problem.loads[name], np.linalg.norm(result.loads.force[:, index], axis=1)
    centre, shift = centre_of_pressure(result, index)
    if _share_outside(result, index, centre, outlines) <= OFTEN:
        return
    bodies, rows = result.problem.fitter.bodies, size > 0.1 * np.max(size)
    distance = [float(np.mean(_outside(result, centre, body, outlines[body])[rows])) for body in range(len(bodies))]
    nearest = int(np.argmin(distance))
    if _share_outside(result, index, result.loads.point[:, index], outlines) <= OFTEN:
        cause = (
            f"its torque, of up to {np.max(np.abs(result.loads.torque[rows, index])):.4g} N m, moves the line of "
            f"action of its force by up to {np.max(shift[rows]):.3g} m: is the torque in another unit, such as N mm, "
            "or about another point? (If this is not the load of a force plate, set `kind: other`.)"
        )
    elif distance[nearest] < OFTEN * OUTSIDE:
        cause = f"it is on the outline of {bodies[nearest]}: does the load act on that body?"
    else:
        cause = (
            "is its point in another frame, such as that of the laboratory, or in another unit, or is the load delayed?"
        )
    far = _outside(result, centre, series.body, outlines[series.body])
    yield (
        f"load '{name}' acts outside of {bodies[series.body]}, up to {np.max(far[rows]):.2g} of its extent from its "
        f"outline (doubtful above {OUTSIDE:g}): {cause}"
    )


def _on_other_body(result: Inverse, index: int, name: str, outlines: np.ndarray) -> Iterator[str]:
    size, own = np.linalg.norm(result.loads.force[:, index], axis=1), result.problem.loads[name].body
    bodies, (centre, _) = result.problem.fitter.bodies, centre_of_pressure(result, index)
    extent = np.linalg.norm(outlines[:, 1] - outlines[:, 0], axis=1)
    off = extent[:, None] * [_outside(result, centre, body, outlines[body]) for body in range(len(bodies))]
    near = (off <= NEAR * extent[:, None]) & (off[own] > off + FARTHER * extent[:, None])
    share, rows = (extent > 0) * (near @ size) / np.sum(size), size > 0
    other = int(np.argmax(share))
    if share[other] >= ON_OTHER:
        far, close = (float(np.average(off[body, rows], weights=size[rows])) for body in (own, other))
        yield (
            f"the point of load '{name}' is {far:.2g} m on average from the outline of {bodies[own]}, on which it "
            f"acts, but {close:.2g} m from that of {bodies[other]}, to which it is nearer for {100 * share[other]:.3g} "
            f"% of its force (doubtful from {100 * ON_OTHER:g} %): does the load act on {bodies[other]}?"
        )


def _metres(result: Inverse, index: int, name: str, outlines: np.ndarray) -> Iterator[str]:
    load, rows = result.problem.spec.loads[name], np.any(result.loads.force[:, index] != 0, axis=1)
    declared = {
        axis: one.unit
        for axis, one in enumerate(load.point or ())
        if not isinstance(one, float) and one.unit is not None and read_unit(one.unit).factor < 1
    }
    in_metres = result.loads.point[:, index].copy()
    largest = float(np.max(np.abs(in_metres[rows][:, list(declared)]), initial=0.0))
    if not (load.is_plate and load.point_frame == GROUND and 0 < largest < LEAST_POINT):
        return
    for axis, unit in declared.items():
        in_metres[:, axis] /= read_unit(unit).factor
    if _share_outside(result, index, in_metres, outlines) <= OFTEN:
        units = listed(sorted(set(declared.values())), "and")
        yield (
            f"the coordinates of the point of load '{name}' with `unit: {units}` are at most {1e3 * largest:.3g} mm "
            f"(doubtful below {1e3 * LEAST_POINT:g} mm), but in metres the same numbers are on "
            f"{result.problem.fitter.bodies[result.problem.loads[name].body]}: leave out the unit."
        )


def _zeros(result: Inverse, index: int, name: str, outlines: np.ndarray) -> Iterator[str]:
    load, series = result.problem.spec.loads[name], result.problem.loads[name]
    if series.point is None or load.point_frame != GROUND:
        return
    size = np.linalg.norm(series.force, axis=1)
    acts, is_loaded = size > 0, size > UNLOADED_SHARE * np.max(size)
    gravity = np.abs(np.array(result.problem.names.mechanism.gravity, dtype=float))
    for axis, column in enumerate(load.point or ()):
        x = series.point[:, axis]
        zero = is_loaded & (x == 0)
        if isinstance(column, float) or not np.any(zero):
            continue
        if np.any(x[acts] != 0):
            bend, near = np.abs(np.diff(x, 2)), acts[2:] & acts[1:-1] & acts[:-2]
            usual = bend[near & (x[2:] != 0) & (x[1:-1] != 0) & (x[:-2] != 0)]
            steps = np.abs(np.diff(x[acts]))
            limit = (
                max(LOST * float(np.median(usual)), STEPS * float(np.min(steps[steps > 0]))) if usual.size else np.inf
            )
            is_lost = bool(np.any(bend[near & zero[1:-1]] > limit))
        else:
            motion, place = result.motion, 3 * series.body
            arm = result.loads.point[:, index] - motion.q[:, place : place + 2]
            slip = motion.v[:, place + axis] + motion.v[:, place + 2] * arm[:, 1 - axis] * (-1, 1)[axis]
            slip[~np.any(result.loads.force[:, index] != 0, axis=1)] = 0.0
            travel = np.ptp(np.cumsum(slip * np.gradient(motion.time)))
            extent = np.linalg.norm(outlines[series.body, 1] - outlines[series.body, 0])
            is_level = gravity[axis] > 0.5 * np.linalg.norm(gravity)  # the height of the plate
            is_lost = not is_level and bool(travel > TRAVELS * extent)
        if is_lost:
            yield (
                f"coordinate {'xy'[axis]} of the point of load '{name}' is exactly zero in {np.sum(zero)} rows with "
                f"forces of up to {np.max(size[zero]):.4g} N, {spans(series.time, zero)}: values that were lost. Leave "
                "out these rows, or measure the point."
            )


def missing_points(problem: InverseProblem) -> Iterator[Finding]:
    """Yield a doubt for each load without a point that is that of a plate, or whose table seems to have its point."""
    for name, told, columns in _without_point(problem):
        if columns:
            look = "looks like its" if len(columns) == 1 else "look like columns of its"
            example = f", as in `point: [{', '.join(map(cited, columns))}]`" if len(columns) == 2 else ""
            yield doubt(
                "load-point",
                f"{told}, but {listed([cited(column) for column in columns], 'and')} {look} point of application: give "
                f"`point`{example}, or write `kind: other` if the force does act at the centre of mass.",
            )
        elif problem.spec.loads[name].kind == "plate":
            yield doubt("load-point", f"{told}, although it is the load of a force plate: give `point`.")


def forces_at_centres(problem: InverseProblem) -> Iterator[str]:
    """Yield a remark on each other load whose measured force acts at a centre of mass because it has no point."""
    for name, told, columns in _without_point(problem):
        if not columns and problem.spec.loads[name].kind is None:
            yield f"{told}. Give `point` if it acts elsewhere, or write `kind: other`."


def _without_point(problem: InverseProblem) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield the name of each load with a measured force and no point, unless it has `kind: other`; a clause that says
    where it acts; and the columns that look like its point.
    """
    for name, load in problem.spec.loads.items():
        measured = any(not isinstance(one, float) for one in load.force or ())
        if measured and load.point is None and load.kind != "other":
            told = f"load '{cited(name)}' has no `point`, so that its force acts at the centre of mass of {load.body}"
            yield name, told, problem.loads[name].like_point
