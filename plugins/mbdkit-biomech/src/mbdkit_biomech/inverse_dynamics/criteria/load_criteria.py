"""Criteria of the verdict on measured loads: their points of application, their signs, and the balance of momentum."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.ndimage import median_filter

from mbdkit.base.text import listed
from mbdkit.trust.finding import Finding
from mbdkit_biomech.inverse_dynamics.compute import Inverse, InverseProblem
from mbdkit_biomech.inverse_dynamics.criteria.doubt import ROUND_OFF, TO_DEVIATION, doubt
from mbdkit_biomech.inverse_dynamics.criteria.glitch_criterion import (
    FORCE,
    LONGEST,
    MOMENT,
    glitch_doubts,
    limits_of_balance,
    spans,
)
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import (
    centre_of_pressure,
    in_body,
    load_point_doubts,
    unmeasured_frames,
)
from mbdkit_biomech.inverse_dynamics.errors.error_bars import ResultBars
from mbdkit_biomech.inverse_dynamics.spec.named_actuators import free_roots
from mbdkit_biomech.persons.plate_contacts import later

#: A plate on the ground cannot push its body sideways, on average, with more than this multiple of its vertical force.
#:
#: In gait, this share is at most 0.2. Plates in starting blocks or walls are exceptions.
FRICTION = 1.0

#: The horizontal force of a plate under a free mechanism has the wrong sign if the other sign reduces the root mean
#: square of the moment of the force about the centre of mass to less than this share.
#:
#: In gait, the line of action passes near the centre of mass: in the packaged examples, a wrong sign multiplies the
#: moment by 8 to 10. In 40 clean data sets of bipeds drawn at random, the share is at least 0.8.
MIRRORED = 0.3

#: Limits for the offset of a plate.
#:
#: The plate is unloaded in the rows in which its force is below `UNLOADED` times its peak. Its offset is examined if at
#: least eight rows, and at least a share of `UNLOADED` of all rows, are unloaded. The plate has an offset if the median
#: of a component of the force in these rows exceeds both `LEAST_OFFSET` times the peak and five times the scatter of
#: this median.
UNLOADED, LEAST_OFFSET = 0.1, 0.005

#: Noise does not explain a residual if the root mean square of the residual exceeds this share of the root mean square
#: of its error bar.
#:
#: Noise alone gives a share of 0.5.
NOISY = 0.8

#: A residual has a peak if it exceeds the median of the rows around it by more than the limit above and by more than
#: this many standard deviations, which Gaussian noise exceeds once in 1e15 rows.
PEAK = 8.0

#: A residual force has an implausible size above `OF_LOAD` times the largest load or `OF_WEIGHT` times the weight of
#: the mechanism.
#:
#: If some loads are not measured, or the model is a part of a body, residual forces are honest. A plate that is missing
#: leaves residuals of about the load on the other plate; a pedal or a handle in place of a plate, some times its load.
#: For a leg without trunk (16 % of the body), the residual force of running is 20 times the weight of the model, and 50
#: times for a shank with its foot. Forces in kN or masses in g change these ratios by a factor of 1000.
OF_LOAD, OF_WEIGHT = 10.0, 100.0

#: A change of the loads is named as the cause of residual forces if it reduces the sum of their squares to at most this
#: share.
EXPLAINS = 0.3

#: Largest time by which loads are shifted, both forward and backward, in the search for a cause [s].
LATEST = 0.1

#: Below this ratio of the loads that the motion needs to the measured ones, the model may be a part of a body, such as
#: a leg without trunk.
PART_OF_BODY = 0.5

#: A plate is late or early if a shift by more than `LAG` [s] improves its agreement with the motion. Shifts up to
#: `LONGEST_LAG` in both directions are tried, `LAGS` in total.
LAG, LONGEST_LAG, LAGS = 0.02, 0.15, 61

#: Limits for the delay of a plate.
#:
#: A foot rests, or moves evenly on a treadmill, while it carries a load. The slip is the standard deviation of the
#: velocity of its point of contact, weighted by the force. A delay is certain if the slip with the shifted load is
#: below `RESTING` times the standard deviation of the velocity of the body, and the slip with the given load is more
#: than `SLIPPING` times as large. In the example `walking`, the slip is 0.12 of this standard deviation; a delay of 0.1
#: s increases it to 2.6 times, and a delay of 0.05 s to 1.3 times. In random motions without rest, no shift gives a
#: slip below 0.25.
RESTING, SLIPPING = 0.2, 1.5

#: A delay is also certain if the points of the load, in the frame of the body, scatter more than `WIDER` times as much
#: about a straight line as with the shifted load, whose scatter counts as at least `NARROW` times the longest link, and
#: if the same holds for the longest shift in this direction.
#:
#: A foot has a sole, and a pedal a point, on which the load stays in whatever way the body moves; with a delay, the
#: motion of the body during the delay adds to the scatter. In the examples and the shared data of walking and running,
#: a shift reduces the scatter to no less than 0.93 of its value, and to no less than half in random motions.
WIDER, NARROW = 3.0, 0.002


def units_of_loads(problem: InverseProblem) -> Iterator[Finding]:
    """Yield a doubt for each unit of a load in the spec that differs from that in the file."""
    for load in problem.loads.values():
        yield from (doubt("units", f"{sentence}.") for sentence in load.contradictions)


def load_doubts(result: Inverse, bars: ResultBars | None) -> Iterator[Finding]:
    """Yield doubts about measured loads."""
    for index, (name, load) in enumerate(result.problem.spec.loads.items()):
        if load.is_plate:
            for criterion in (_direction, _horizontal_sign, _offset, _lag):
                yield from criterion(result, index, name)
            yield from glitch_doubts(result, name)
    yield from load_point_doubts(result)
    yield from _balance(result, bars)


def _lag(result: Inverse, index: int, name: str) -> Iterator[Finding]:
    """Yield a doubt if the body of a plate slips while the plate is loaded, or if the point of the load leaves its line
    on the body, but not if the load is shifted in time.
    """
    time, place = result.motion.time, 3 * result.problem.loads[name].body
    q, v = result.motion.q[:, place : place + 3], result.motion.v[:, place : place + 3]
    force, point = result.loads.force[:, index], centre_of_pressure(result, index)[0]
    force = np.where(_is_left_out(force)[:, None], 0.0, force)
    body = result.problem.fitter.bodies[place // 3]
    usual = float(np.sqrt(np.sum(np.var(v[:, :2], axis=0))))
    if not np.any(force) or not usual > 0:
        return
    slip: dict[float, float] = {}
    width: dict[float, float] = {}
    for delay in np.linspace(-LONGEST_LAG, LONGEST_LAG, LAGS).tolist():
        is_known = (time + delay >= time[0]) & (time + delay <= time[-1])
        weight = np.linalg.norm(later(time, force, delay), axis=1) * is_known
        shifted = later(time, point, delay)
        arm = shifted - q[:, :2]
        of_contact = v[:, :2] + v[:, 2:] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        if not (whole := float(np.sum(weight))) > 0:
            return
        off = of_contact - weight @ of_contact / whole
        slip[delay] = float(np.sqrt(weight @ np.sum(off**2, axis=1) / whole))
        own = in_body(q, shifted)
        own -= weight @ own / whole
        width[delay] = float(np.sqrt(max(0.0, np.linalg.eigvalsh((own.T * weight) @ own / whole)[0])))
    line = NARROW * result.problem.fitter.manifold.length
    slips = f"while it acts, the point of {body} under it slips with {{:.3g}} m/s, but only with {{:.2g}} m/s"
    scatters = f"its points on {body} scatter by {{:.2g}} m about a straight line, but only by {{:.2g}} m"
    for values, most, floor, ratio, told in (
        (slip, RESTING * usual, 0.0, SLIPPING, slips),
        (width, np.inf, line, WIDER, scatters),
    ):
        best, given = min(values, key=lambda delay: values[delay]), values[min(values, key=abs)]
        limit, at_end = ratio * max(values[best], floor), values[float(np.copysign(LONGEST_LAG, best))]
        if values is width and at_end <= limit:  # the scatter must be small for this delay only
            continue
        if LAG < abs(best) < LONGEST_LAG and values[best] <= most and given > limit:
            yield doubt(
                "load-time",
                f"load '{name}' seems to be about {abs(best):.3g} s too {'late' if best > 0 else 'early'}: "
                f"{told.format(given, values[best])} if the load is shifted by this time (doubtful above {ratio:g} "
                "times as much).",
            )
            return


def _is_left_out(force: np.ndarray) -> np.ndarray:
    """Return which frames (T,) say nothing about the time of a plate, given its force (T, 2): those in which it is
    unloaded, and those of contacts that one end of the record cuts.

    In the part of a stance that is known, the foot moves in another way than in the whole, as if the load were late.
    """
    size = np.linalg.norm(force, axis=1)
    left_out = size <= UNLOADED * np.max(size, initial=0.0)
    if (unloaded := np.flatnonzero(left_out)).size:
        left_out[: unloaded[0]] = left_out[unloaded[-1] :] = True
    return np.asarray(left_out)


def _direction(result: Inverse, index: int, name: str) -> Iterator[Finding]:
    gravity = np.array(result.problem.names.mechanism.gravity, dtype=float)
    if not np.any(gravity):
        return
    force, direction = result.loads.force[:, index], -gravity / np.linalg.norm(gravity)
    up, across = force @ direction, force @ [direction[1], -direction[0]]
    largest = float(np.max(np.linalg.norm(force, axis=1), initial=0.0))
    vertical, horizontal = float(np.mean(np.abs(up))), float(np.mean(np.abs(across)))
    if np.mean(up) < -ROUND_OFF * largest:
        yield doubt(
            "load-sign",
            f"load '{name}' pulls its body down on average, by {-np.mean(up):.4g} N: force plates often give the "
            f"force on the plate, whose sign must be reversed with `scale: -1`; or the y axis points down. (If this "
            f"is not the load of a force plate, set `kind: other`.)",
        )
    if horizontal > FRICTION * vertical + ROUND_OFF * largest:
        yield doubt(
            "load-direction",
            f"the force of load '{name}' is {horizontal:.4g} N along the horizontal, but only {vertical:.4g} N along "
            f"the vertical (means of absolute values; doubtful above {FRICTION:g} times as much): is the column of the "
            "vertical force empty, exchanged with another one, or in another unit? (If this is not the load of a force "
            "plate, set `kind: other`.)",
        )


def _horizontal_sign(result: Inverse, index: int, name: str) -> Iterator[Finding]:
    mechanism, q = result.problem.names.mechanism, result.motion.q
    gravity = np.array(mechanism.gravity, dtype=float)
    if len(free_roots(mechanism)) != 1 or not np.any(gravity):
        return
    masses = np.array([body.mass for body in mechanism.bodies.values()])
    centre = np.stack([q[:, axis::3] @ masses for axis in (0, 1)], axis=1) / np.sum(masses)
    arm, force = result.loads.point[:, index] - centre, result.loads.force[:, index]
    up = -gravity / np.linalg.norm(gravity)
    mirrored = 2 * (force @ up)[:, None] * up - force
    given, other = (
        float(np.sqrt(np.mean((arm[:, 0] * one[:, 1] - arm[:, 1] * one[:, 0]) ** 2))) for one in (force, mirrored)
    )
    if other < MIRRORED * given:
        yield doubt(
            "load-sign",
            f"the horizontal force of load '{name}' seems to have the wrong sign: the moment of the load about the "
            f"centre of mass has a root mean square of {given:.4g} N m, but only {other:.4g} N m with the other sign "
            f"(doubtful below {MIRRORED:g} times as much).",
        )


def _offset(result: Inverse, index: int, name: str) -> Iterator[Finding]:
    force = result.loads.force[:, index]
    peak = float(np.max(np.abs(force), initial=0.0))
    rows = np.linalg.norm(force, axis=1) < UNLOADED * peak
    if np.sum(rows) < max(8, UNLOADED * len(rows)):
        return
    middle = np.median(force[rows], axis=0)
    scatter = TO_DEVIATION * np.median(np.abs(force[rows] - middle), axis=0) / np.sqrt(np.sum(rows))
    if np.any(np.abs(middle) > np.maximum(LEAST_OFFSET * peak, 5 * scatter)):
        yield doubt(
            "load-offset",
            f"load '{name}' is about ({middle[0]:.3g}, {middle[1]:.3g}) N in {np.sum(rows)} rows in which it is below "
            f"{UNLOADED:g} of its peak, and should be zero (doubtful above {LEAST_OFFSET:g} of it): the plate has an "
            "offset.",
        )


def _balance(result: Inverse, bars: ResultBars | None) -> Iterator[Finding]:
    """Yield a doubt if the loads and the motion of a mechanism with one free root contradict Newton's second law."""
    roots = free_roots(result.problem.names.mechanism)
    load, weight, limits = limits_of_balance(result)
    largest = max(load, weight)
    if len(roots) != 1 or not largest > 0:
        return
    residual, noise = residual_wrench(result, roots[0], bars, only_residuals=load == 0)
    height = limits[2] / (MOMENT * largest)
    unmeasured = unmeasured_frames(result)
    inside = judged_frames(len(residual), unmeasured)
    if unmeasured:
        at = listed([f"{body} {spans(result.motion.time, rows)}" for body, rows in unmeasured.items()], "and")
        lack = "forces of joints lack it then, and residual forces are judged only where all loads are measured"
        yield Finding("residuals", None, f"the force of the ground is not measured on {at}: {lack}")
    if not inside.any():
        return
    beyond = np.mean(residual[inside] ** 2, axis=0) > NOISY**2 * np.mean(noise[inside] ** 2, axis=0)
    over = beyond & (np.quantile(np.abs(residual)[inside], 0.95, axis=0) > limits)
    carried = float(np.max(np.linalg.norm(residual[inside, :2], axis=1)))
    sizes = [(carried / load, OF_LOAD, "the largest load")] if load > 0 else []
    sizes += [(carried / weight, OF_WEIGHT, "the weight of the model")] if weight > 0 else []
    told_sizes = listed([f"{ratio:.2g} times {of}" for ratio, _, of in sizes], "and")
    peaks = _peaks(residual, noise, limits, inside) & (load > 0)
    if np.any(over) or np.any(peaks):
        peak = np.max(np.abs(residual)[inside], axis=0)
        axes = np.flatnonzero(over | np.any(peaks, axis=0))
        told = [f"{peak[axis]:.4g} {('N along x', 'N along y', 'N m')[axis]}" for axis in axes]
        of = "largest load" if load >= weight else "weight"
        limit = f"doubtful above {limits[0]:.3g} N or {limits[2]:.3g} N m, {FORCE:g} of the {of} and {MOMENT:g}"
        cause = "Without loads, these forces carry the model: is the load of a force plate missing?"
        if not np.any(over):
            cause = (
                f"They exceed the limit only for at most {LONGEST} rows at a time, {spans(result.motion.time, peaks)}: "
                "a glitch of a load, or an impact that the smoothing removes from the motion."
            )
        elif load > 0:
            cause = _cause(result, residual / [1, 1, height], height, inside)
        yield doubt(
            "residuals",
            f"motion and loads contradict Newton's second law: the residual actuators of {roots[0]} reach "
            f"{listed(told, 'and')} ({limit} of its moment at the height of the mechanism). The residual force is up "
            f"to {carried:.4g} N, {told_sizes}. {cause}",
        )
    if any(ratio > limit for ratio, limit, _ in sizes):
        limits_told = listed([f"{limit:g} times {of}" for _, limit, of in sizes], "or")
        yield doubt(
            "residual-size",
            f"the residual force of {roots[0]} is up to {carried:.4g} N, {told_sizes} (doubtful above {limits_told}), "
            "which missing loads or bodies hardly explain: is a force or a mass in another unit, such as kN or g?",
        )


def _peaks(residual: np.ndarray, noise: np.ndarray, limits: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return where residual forces and moments (T, 3) rise for a few rows by more than their limits and their noise.

    The motion is smoothed, so that it causes no such peaks; a load with a glitch does.
    """
    off = np.abs(residual - median_filter(residual, (2 * LONGEST + 1, 1), mode="nearest"))
    usual = TO_DEVIATION * np.median(off[inside], axis=0)
    peaks = off > np.maximum(limits, PEAK * np.maximum(usual, noise / 2))  # error bars are two standard deviations
    return np.asarray(peaks & inside[:, None])


def judged_frames(count: int, unmeasured: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the frames (T,) with all loads, without both ends, where derivatives are inaccurate."""
    inside, ends = np.zeros(count, dtype=bool), count // 20
    inside[ends : count - ends] = True
    return np.asarray(inside & ~np.any(list(unmeasured.values()), axis=0)) if unmeasured else inside


def residual_wrench(
    result: Inverse, root: str, bars: ResultBars | None, *, only_residuals: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces x, y and the moment of the actuators of a root, and their error bars, (T, 3) each.

    Error bars that are not known are zero. If `only_residuals`, actuators that the spec declares, which may carry the
    mechanism if there is no load, are left out.
    """
    body = list(result.problem.names.mechanism.bodies).index(root)
    values, noise = np.zeros((2, len(result.motion.time), 3))
    for place, actuator in enumerate(result.problem.actuators):
        if only_residuals and not actuator.is_residual:
            continue
        own, axis = actuator.quantity.unscaled.place or (None, 0)
        if own == body:
            values[:, axis] += result.dynamics.value[:, place] * actuator.quantity.scale
            if bars is not None:
                noise[:, axis] += np.nan_to_num(bars.actuators[:, place]) * actuator.quantity.scale
    return values, noise


def _cause(result: Inverse, residual: np.ndarray, height: float, inside: np.ndarray) -> str:
    """Return a sentence that names the change of the loads that explains most of the residual forces and moments.

    Parameters
    ----------
    residual
        (T, 3) residual forces, and residual moment about the root divided by the height of the mechanism.
    inside
        (T,) whether a row is judged.
    """
    time, loads = result.motion.time, result.loads
    root = result.problem.names.body(free_roots(result.problem.names.mechanism)[0], "model")
    centre = result.motion.q[:, 3 * root : 3 * root + 2]

    def wrench(force: np.ndarray, point: np.ndarray, torque: np.ndarray) -> np.ndarray:
        arm = point - centre[:, None]
        moment = arm[..., 0] * force[..., 1] - arm[..., 1] * force[..., 0] + torque
        return np.asarray(np.concatenate([force, moment[..., None] / height], axis=2).sum(axis=1))

    load = wrench(loads.force, loads.point, loads.torque)
    needed, usual = residual + load, EXPLAINS * np.sum(residual[inside] ** 2)

    def explains(other: np.ndarray) -> bool:
        return bool(np.sum((needed - other)[inside] ** 2) < usual)

    if explains(-load):
        return "The loads seem to have the wrong sign."
    square = float(np.sum(load[inside] ** 2))
    factor = float(np.sum((needed * load)[inside])) / square if square > 0 else 0.0
    if 0.02 < factor < PART_OF_BODY and explains(factor * load):
        mass = sum(body.mass for body in result.problem.names.mechanism.bodies.values())
        return (
            f"The loads fit a body of {mass / factor:.3g} kg, but the model has {mass:.3g} kg. If it is a part of the "
            "body, such as a leg without trunk, accept `residuals`; otherwise, bodies are missing, masses are too "
            f"small, or the loads are {1 / factor:.3g} times too large."
        )
    if factor > 0 and abs(factor - 1) > 0.02 and explains(factor * load):
        size, other = ("small", "its masses are too large") if factor > 1 else ("large", "a body is missing from it")
        return (
            f"The loads seem to be too {size}: multiplied by {factor:.3g}, they fit. Or they are right, and the model "
            f"is wrong: {other}."
        )
    offset = np.mean(residual[inside, :2], axis=0)
    if explains(load + np.append(offset, 0.0)):
        return f"The loads seem to have an offset of ({-offset[0]:.3g}, {-offset[1]:.3g}) N."
    late: dict[float, float] = {}
    for delay in np.linspace(-LATEST, LATEST, 41).tolist():
        moved = [later(time, one, delay) for one in (loads.force, loads.point, loads.torque)]
        late[delay] = float(np.sum((needed - wrench(*moved))[inside] ** 2))
    best = min(late, key=lambda delay: late[delay])
    if late[best] < usual:
        return f"The loads seem to be {abs(best):.3g} s too {'late' if best > 0 else 'early'}."
    return "A load or a body is missing, or a load has a wrong sign, scale, frame or time."
