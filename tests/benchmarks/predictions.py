"""Predictions beside Moco: a squat-to-stand of the same leg on one core; the gain of a spring at the knee; and times
against the number of intervals.

Moco runs in a Python that has the package `opensim`, whose path is in the environment variable OPENSIM_PYTHON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import mbdkit
from mbdkit_predict.nonlinear_program import Stop
from mbdkit_predict.predict_loading import load_predict_spec
from mbdkit_predict.predicted_run import transcribed

LARGEST = {"hip": 150.0, "knee": 300.0, "ankle": 150.0}
"""Largest torques of the joints [N m]."""
START = {"hip": 2.0, "knee": -2.0, "ankle": 0.5}
"""Angles of the joints at the start [rad]; all are 0 at the end."""
MESHES = 25, 50
"""Numbers of intervals of Moco."""
COLLOCATIONS = {"points": 3, "intervals": 20}, {"points": 3, "intervals": 10}, {"points": 5, "intervals": 3}
"""First meshes of predictions, and their numbers of points."""
COUNTS = 25, 50, 100, 200, 400
"""Numbers of intervals whose times are compared."""
SPRING = "forces.spring.stiffness"


def squat(**sections: Any) -> dict[str, Any]:
    """Return a squat-to-stand in 1 s with the least sum of squared torques, as shares of the largest ones."""
    bodies = {"hip": ("thigh", "trunk"), "knee": ("shank", "thigh"), "ankle": ("foot", "shank")}
    motors = {
        f"{name}_motor": {"type": "torque", "body": body, "reaction_body": other, "value": 0}
        for name, (body, other) in bodies.items()
    }
    floor = {"type": "weld", "bodies": ["ground", "foot"], "at": [0.0, 0.0702], "angle": 0.0}
    model = {
        "name": "leg", "root": "trunk", "trunk_share": 0.5, "hip_position": [0.0, 0.954], "joints": {"floor": floor},
        "forces": motors | {"spring": {"type": "torsion-spring", "bodies": ["thigh", "shank"], "stiffness": 0.0}},
    }  # fmt: skip
    still = {f"{body}.angular_velocity": 0 for body in ("trunk", "thigh", "shank")}
    own: dict[str, Any] = {
        "controls": {f"forces.{name}_motor.value": {"bounds": [-x, x]} for name, x in LARGEST.items()},
        "duration": 1.0,
        "initial": {f"{name}.angle": x for name, x in START.items()} | still,
        "final": dict.fromkeys((f"{name}.angle" for name in START), 0) | still,
        "minimize": "integral(" + " + ".join(f"(forces.{n}_motor.value/{x})**2" for n, x in LARGEST.items()) + ")",
    }
    return {"mbdkit_predict": 1, "base": {"model": model}, **own, **sections}


def leg_of_moco() -> dict[str, Any]:
    """Return the leg as the chain ankle, knee, hip from the ground on, whose angles are those of the distal bodies."""
    mechanism: Any = load_predict_spec(squat()).mechanism()
    joints = {name: mechanism.joints[name].points for name in ("floor", *START)}
    chain = {
        "ankle": ("ground", joints["floor"][0], "shank", joints["ankle"][0]),
        "knee": ("shank", joints["knee"][1], "thigh", joints["knee"][0]),
        "hip": ("thigh", joints["hip"][1], "trunk", joints["hip"][0]),
    }
    return {
        "gravity": 9.81,
        "duration": 1.0,
        "bodies": {b: [mechanism.bodies[b].mass, mechanism.bodies[b].inertia] for b in ("shank", "thigh", "trunk")},
        "joints": {name: [*pin, LARGEST[name]] for name, pin in chain.items()},
        "ends": {name: [-START[name], 0.0] for name in chain},
    }


def moco(intervals: int) -> Mapping[str, Any]:
    """Return objective and times of Moco on a mesh."""
    script = Path(__file__).with_name("moco_squat.py")
    command = [os.environ.get("OPENSIM_PYTHON", sys.executable), str(script), str(intervals)]
    one = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ""}
    given: Any = {"input": json.dumps(leg_of_moco()), "capture_output": True, "text": True, "check": True, "env": one}
    with tempfile.TemporaryDirectory() as folder:  # Moco writes a file there
        done = subprocess.run(command, cwd=folder, **given)
    result: Mapping[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def predictions(console: Console) -> None:
    """Print objectives and processor times of a squat-to-stand, and the gain and the sensitivity of a spring."""
    _beside_moco(console)
    _with_a_spring(console)
    _by_intervals(console)


def _beside_moco(console: Console) -> None:
    table = Table("program", "intervals", "objective", "processor time [s]", title="Squat-to-stand, one core")
    mbdkit.predict(squat(tolerance=1e-2))  # imports are not timed
    for collocation in COLLOCATIONS:
        begin = time.process_time()
        run: Any = mbdkit.predict(squat(tolerance=1e-4, collocation=collocation))
        value = f"{run.objective:.10f} ± {run.objective_error:.1g}"
        taken = time.process_time() - begin
        program = f"mbdkit, {collocation['points']} points"
        table.add_row(program, ", ".join(str(count) for count, _ in run.mesh), value, f"{taken:.2f}")
    try:
        for intervals in MESHES:
            result = moco(intervals)
            table.add_row("Moco", str(intervals), f"{result['objective']:.10f}", f"{result['cpu_s']:.2f}")
    except (OSError, subprocess.CalledProcessError):
        console.print("Moco is not installed: set OPENSIM_PYTHON to a Python that has the package opensim")
    console.print(table)


def _with_a_spring(console: Console) -> None:
    begin = time.process_time()
    chosen = {"parameters": {SPRING: {"bounds": [0.0, 200.0], "start": 50.0}}}
    run: Any = mbdkit.predict(squat(**chosen, compare={f"model.{SPRING}": 0.0}, tolerance=1e-4))
    console.print(run.summary(), f"processor time {time.process_time() - begin:.1f} s", sep="\n")

    def optimum(stiffness: float, **sections: Any) -> Any:
        spec = squat(tolerance=1e-8, collocation={"points": 5, "intervals": 20}, **sections)
        spec["base"]["model"]["forces"]["spring"]["stiffness"] = stiffness
        return mbdkit.predict(spec)

    slope = optimum(30.0, sensitivities=[SPRING]).sensitivities[SPRING]
    low, high = (optimum(30.0 + step).objective for step in (-0.1, 0.1))
    difference = (high - low) / 0.2
    console.print(f"derivative at 30 N m/rad: {slope:.8g} by multipliers, {difference:.8g} by optima, ",
                  f"relative difference {abs(slope / difference - 1.0):.1g}")  # fmt: skip


def _by_intervals(console: Console) -> None:
    table = Table("intervals", "iterations", "processor time [s]", "per interval [ms]", title="First mesh of the squat")
    for count in COUNTS:
        problem = transcribed(load_predict_spec(squat(collocation={"intervals": count})))
        begin = time.process_time()
        mesh = problem.solved(problem.guess(), Stop())
        taken = time.process_time() - begin
        table.add_row(str(count), str(mesh.iterations), f"{taken:.2f}", f"{1e3 * taken / count:.1f}")
    console.print(table)
