"""Phases that end where a motion passes a jump, and in which forces and rates keep to their side of it.

A jump is made by an operation of the expressions whose value is constant before and after it, such as the tangens
hyperbolicus of a large number, or a quotient x/abs(x). In each phase, this operation is replaced by its value there, so
that no point of a phase meets the other side. A phase ends where what the operation depends on has the value that it
has in the middle of the jump. How much the true expressions change the objective is estimated afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from mbdkit_predict.guessed_motion import solved_motion
from mbdkit_predict.jumps import Jump, MotionPath
from mbdkit_predict.point_functions import Held, operations_of
from mbdkit_predict.transcription import Mesh, Switching, Transcription

AROUND = np.array([-12.0, -4.0, 4.0, 12.0])  #: Times around a jump, in multiples of half its time.
MOST = 12  #: Largest number of jumps of a motion: more are those of a motion that slides along one.
FLAT = 0.01  #: Largest change before and after a jump, as a share of it.
EVEN = 10.0  #: Largest ratio of changes of what a jump depends on.
NOT_HELD = (
    "What jumps at t = {:.4g} s has no value before and after it, so that it cannot be held in phases that end there: "
    "write it with abs or tanh."
)
VARIES = (
    "What jumps along the motion varies between the jumps, so that it cannot be held there: write the jump as a factor "
    "of its own, as in speed*tanh(1e6*x) or speed*(x/abs(x))."
)
LEAST = 1e-9  #: Least change of an operation that jumps, as a share of its values: smaller ones are rounding.
ZERO = 1e-6  #: Values in the middle of a jump that count as zero, as a share of the change around it.
PASSES, HALVINGS = 8, 60  #: How often operations that jump are searched for, and how often a time is bisected.
SAMPLES, LEFT_OUT = 65, 3  #: Number of times in each part at which operations are evaluated; extremes left out.


def switching_of(method: Transcription, mesh: Mesh, jumps: Sequence[Jump], *, is_divided: bool) -> Switching | str:
    """Return the parts of a motion between its jumps; a sentence if this is not possible, an empty one if no jump asks
    for it.

    Without `is_divided`, phases stay whole, and only the jumps at their ends are held.
    """
    path, unheld = MotionPath(method, mesh), method.functions.unheld
    last = np.flatnonzero(np.diff(method.phase_of, append=-1))
    ends = np.array(mesh.values["duration"] @ mesh.grid.ends[:, mesh.grid.ends_of_phases()])[last]
    places, operations = dict[float, ca.SX | None](dict.fromkeys(ends.tolist())), dict[int, float]()
    for jump in jumps:
        is_end = bool(min(abs(ends - jump.time)) <= 2.0 * jump.half)
        if is_end or is_divided:
            held = _held(path, unheld, jump)
            operations |= {k: abs(after - before) for k, (before, after) in held.items()}
            surface = None if is_end or not held else _surface(path, unheld, held, jump)
            if not held or (surface is None and not is_end):
                return NOT_HELD.format(jump.time)
            if surface:
                places[surface[0]] = surface[1]
    if len(places) - len(ends) > MOST:
        return f"The motion passes {len(places) - len(ends)} jumps, too many for phases that end at them."
    if not operations:
        return ""
    times = np.array(sorted(places))
    begins = np.append(0.0, times[:-1])
    nodes = operations_of(unheld, path.given, {}).nodes
    at = (begins[:, None] + (times - begins)[:, None] * np.linspace(0.0, 1.0, SAMPLES + 2)[1:-1]).ravel()
    values = path.evaluate([nodes[k] for k in operations], at, at)
    values = np.sort(values.reshape(len(operations), len(times), SAMPLES), axis=2)
    sides = values[:, :, SAMPLES // 2]
    varied = (values[:, :, -1 - LEFT_OUT] - values[:, :, LEFT_OUT]).max(axis=1)
    if np.any(varied > FLAT * np.array([*operations.values()])):
        return VARIES
    durations = times - begins
    return Switching(
        tuple(t for t in times.tolist() if places[t] is not None), np.searchsorted(ends, times), durations,
        {k: places[t] for k, t in enumerate(times.tolist()) if places[t] is not None},
        sides, Held(unheld, tuple(operations)),
        solved_motion(mesh.times, {**mesh.values, "duration": durations}, method.system, method.system),
    )  # fmt: skip


def _around(path: MotionPath, nodes: Sequence[ca.SX], jump: Jump) -> np.ndarray:
    return path.evaluate(nodes, jump.time + jump.half * AROUND, np.full(4, jump.time))


def _held(path: MotionPath, function: ca.Function, jump: Jump) -> dict[int, tuple[float, float]]:
    """Return the operations that make a jump, with their values before and after it."""
    held = dict[int, tuple[float, float]]()
    for _ in range(PASSES):
        new = dict[int, tuple[float, float]]()
        for side in (0, 1):
            known = operations_of(function, path.given, {k: ca.SX(x[side]) for k, x in held.items()})
            values = _around(path, known.nodes, jump)
            before, change, after = abs(np.diff(values, axis=1)).T
            steps = (np.maximum(before, after) <= FLAT * change) & (change > LEAST * abs(values).max(axis=1))
            first = [k for k in np.flatnonzero(steps).tolist() if not steps[known.parents[k]].any()]
            new |= {k: (values[k, 1], values[k, 2]) for k in first}
        if not new:
            return held
        held |= new
    return {}


def _surface(
    path: MotionPath, function: ca.Function, held: Mapping[int, tuple[float, float]], jump: Jump
) -> tuple[float, ca.SX] | None:
    """Return the time of a jump, and an expression of the state and the time that is zero there."""
    nodes, parents, _ = operations_of(function, path.given, {})
    changes = np.diff(_around(path, nodes, jump), axis=1)
    sizes = abs(changes)
    is_even = (abs(np.sign(changes).sum(axis=1)) == 3) & (EVEN * sizes.min(axis=1) >= sizes.max(axis=1))
    found = list[tuple[bool, float, ca.SX]]()
    for k, sides in held.items():
        causes, waiting = dict[int, None](), list(parents[k])
        while waiting:
            node = waiting.pop()
            if is_even[node]:
                causes[node] = None
            elif sizes[node].any():
                waiting += parents[node]
        low, high = jump.time + jump.half * AROUND[1:3]
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            (value,) = path.evaluate([nodes[k]], np.array([middle]), np.array([jump.time]))[0]
            low, high = (middle, high) if abs(value - sides[0]) < abs(value - sides[1]) else (low, middle)
        for node in causes:
            (level,) = path.evaluate([nodes[node]], np.array([high]), np.array([jump.time]))[0]
            is_zero = abs(level) <= ZERO * sizes[node, 1]
            scale = sizes[node, 1] / (AROUND[2] - AROUND[1]) / jump.half * path.ends[-1]
            expression = (nodes[node] - (0.0 if is_zero else level)) / scale
            if not any(x.numel() and ca.depends_on(expression, x) for x in path.unknown):
                found.append((not is_zero, high, expression))
    best = min(found, key=lambda row: row[0], default=None)
    return None if best is None or (best[0] and len(found) > 1) else best[1:]
