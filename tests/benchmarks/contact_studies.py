"""100 discs in a pit, how accurately the laws of contact hold; and 1,000 sit-downs as a study."""

from __future__ import annotations

import tempfile
import time
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit.spec import load_spec
from tests.witness.pit import RADIUS, pit

SIT_DOWNS = 1000
"""Runs of the study; fewer, from `FEW` on, if these take longer than `LONG`, or `SHORT` with --quick."""
FEW, SHORT, LONG = 4, 2.0, 20.0
"""Runs, s, s."""


def law_errors(run: mbdkit.Run, spec: dict[str, Any], step: float) -> tuple[float, float, int]:
    """Return the errors of complementarity and of friction, over the largest impulse, and the sum of closed contacts.

    Let P and T be the normal and tangential impulses of a contact in a step h, and u_n and u_t its velocities after it.
    The error of complementarity is the largest of min(P, m u_n) and -m (u_n + g/h), and that of friction the largest
    |min(mu P - |T|, m |u_t|)|, of all contacts with P > 0 or g = 0. Here g is the gap that the contact would have at
    the end of the step without impulses, or 0 if it would overlap: a pressed contact may stay as it is or close its
    gap. The step is that of the method of Moreau and Jean, whose friction acts on the second body's circle; gaps and
    gradients are computed here, from the recorded positions and velocities.
    """
    bodies, contacts = spec["model"]["bodies"], spec["model"]["contacts"]
    q = np.stack([np.column_stack([run.bodies[name].position, run.bodies[name].angle]) for name in bodies], axis=1)
    v = np.stack(
        [np.column_stack([run.bodies[name].velocity, run.bodies[name].angular_velocity]) for name in bodies], axis=1
    )
    column = {name: i for i, name in enumerate(run.contacts)}
    pairs = list(combinations(range(len(bodies)), 2))
    a, b = np.transpose(pairs)
    index = {name: i for i, name in enumerate(bodies)}
    worst, largest, closed = np.zeros(2), 0.0, 0
    names = list(bodies)
    walls = {
        name: (contact["shapes"][0]["line"], index[contact["bodies"][1]])
        for name, contact in contacts.items()
        if name != "circles"
    }
    keys = [f"circles.{names[i]}.{names[j]}" for i, j in pairs] + list(walls)
    some = [column[key] for key in keys]
    normal_force, friction_force = (run.array(f"contacts/{kind}_force")[:, some] for kind in ("normal", "friction"))
    point = np.array([line["point"] for line, _ in walls.values()])
    outward = np.array([line["normal"] for line, _ in walls.values()])
    at_wall = np.array([i for _, i in walls.values()])
    gravity = np.array([0.0, -9.81, 0.0])

    def normals(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        way = x[b, :2] - x[a, :2]
        length = np.linalg.norm(way, axis=1)
        gap = np.concatenate([length - 2 * RADIUS, np.sum((x[at_wall, :2] - point) * outward, axis=1) - RADIUS])
        return gap, np.concatenate([way / length[:, None], outward])

    for i in range(1, len(q)):
        free = q[i - 1] + step * (v[i - 1] + 0.5 * step * gravity)
        gap, _ = normals(free)
        middle, n = normals(q[i - 1] + 0.5 * step * v[i - 1])
        t = np.column_stack([n[:, 1], -n[:, 0]])
        first = np.concatenate([v[i][a], np.zeros((len(walls), 3))])
        second = np.concatenate([v[i][b], v[i][at_wall]])
        u = second[:, :2] - first[:, :2]
        u_n = np.sum(u * n, axis=1)
        u_t = np.sum(u * t, axis=1) + RADIUS * second[:, 2] + (RADIUS + middle) * first[:, 2]
        p, f = step * normal_force[i], step * friction_force[i]
        lowest = -np.maximum(gap, 0.0) / step
        acting = (gap <= 0.0) | (p > 0.0)
        by_normal = np.maximum(np.minimum(p, u_n), lowest - u_n)
        by_friction = np.abs(np.minimum(0.3 * p - np.abs(f), np.abs(u_t)))
        worst = np.maximum(worst, [np.max(error[acting], initial=0.0) for error in (by_normal, by_friction)])
        largest, closed = max(largest, float(np.max(p))), closed + int(np.sum(p > 0.0))
    return float(worst[0]) / largest, float(worst[1]) / largest, closed


def discs(console: Console, end: float) -> None:
    """Print speed, overlap and error of the laws of contact of 100 discs in a pit, by `moreau-jean` with 1 ms."""
    step = 1e-3
    spec = pit(10, 10) | {"time": {"end": end, "step": step}}
    timed = mbdkit.run(spec | {"output": {"every": 10**7, "quantities": []}})
    run = mbdkit.run(spec | {"output": {"every": 1, "quantities": []}})
    complementarity, friction, closed = law_errors(run, spec, step)
    table = Table(title=f"100 discs in a pit, moreau-jean, step {step:g} s, {end:g} s")
    for heading in (
        "a step",
        "contacts with impulses a step",
        "contacts a second",
        "deepest overlap",
        "complementarity",
        "friction",
    ):
        table.add_column(heading)
    seconds, steps = float(timed.stats["cpu_s"]), int(timed.stats["steps"])
    overlap = max(0.0, -float(np.min(run.array("contacts/gap"))))
    table.add_row(
        f"{1e3 * seconds / steps:.3g} ms",
        f"{closed / steps:.3g}",
        f"{closed / seconds:.3g}",
        f"{overlap:.1e} m",
        f"{complementarity:.1e}",
        f"{friction:.1e}",
    )
    table.caption = (
        "Contacts a second: contacts with impulses in all steps, over the processor time of the steps. Complementarity "
        "and friction: largest errors of these laws, over the largest impulse."
    )
    console.print(table)


TREATMENTS: dict[str, dict[str, Any]] = {
    "time-stepping": {
        "integrator": {"name": "moreau-jean"},
        "time": {"end": 3.0, "step": 2e-3},
        "output": {"every": 5},
    },
    "compliant": {},
    "event-driven": {},
}
"""Sections of the spec, by treatment."""


def _study(count: int, treatment: str) -> tuple[float, int]:
    """Return the wall time [s] and the number of complete runs."""
    rng = np.random.default_rng(1)
    values = {
        "parameters.seat": rng.uniform(0.42, 0.50, count),
        "model.bodies.trunk.mass": rng.uniform(40.0, 62.0, count),
    }
    spec = load_spec("sit-down", contact={"treatment": treatment}, **TREATMENTS[treatment])
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        study = mbdkit.ensemble(spec, values, workers=2, out=Path(folder) / "study", notify=lambda text: None)
        seconds = time.perf_counter() - begin
        return seconds, sum(point.status == "complete" for point in study.points)


def sit_downs(console: Console, quick: bool) -> None:
    """Print the wall time of a study of sit-downs with random heights of the seat and masses of the trunk."""
    table = Table(title=f"{SIT_DOWNS} sit-downs as a study with two workers")
    for heading in ("treatment", "runs", "complete", "wall time", f"of {SIT_DOWNS} runs"):
        table.add_column(heading)
    for treatment in TREATMENTS:
        count = FEW
        while (result := _study(count, treatment))[0] < (SHORT if quick else LONG) and count < SIT_DOWNS:
            count = min(5 * count, SIT_DOWNS)
        seconds, complete = result
        table.add_row(treatment, f"{count}", f"{complete}", f"{seconds:.3g} s", f"{seconds * SIT_DOWNS / count:.3g} s")
    table.caption = "Fewer runs are made, and their time is scaled, if runs take long."
    console.print(table)
