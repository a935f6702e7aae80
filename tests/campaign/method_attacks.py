"""Integrators made from the templates of ``mbdkit plugins new --like``, on random mechanisms, and killed.

The mechanisms have first-order states, drivers whose velocity jumps, sampled controllers, events that note and that set
states, and rigid contacts.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import mbdkit
from tests.benchmarks.templates import install_templates
from tests.runs.resuming.killed_runs import killed

from .attack import Attack

EXACT = {"name": "dop853", "adaptive": True, "rtol": 1e-12, "atol": 1e-13}
END = 0.5
CONTROLLED = {"adaptive": 1e-3, "rosenbrock": 1e-3, "external": 1e-3}
"""Templates that control their steps, with the largest error of their runs relative to the size of the mechanism; their
tolerances are 1e-8.
"""
STEP = 2e-3
"""Step of the others [s]; their error must fall by the factor `FALLS` if it is halved, or be below `SMALL`."""
FALLS, SMALL = 0.45, 1e-7


@functools.cache
def _installed() -> dict[str, str]:
    """Install the templates for this process; return the names of the integrators by the kind of the template."""
    return install_templates(Path(tempfile.mkdtemp(prefix="mbdkit-methods-")))


def drawn(random: np.random.Generator) -> dict[str, Any]:
    """Return the model and the events of a mechanism: a driven slide with two or three rods."""

    def number(low: float, high: float) -> float:
        return round(float(random.uniform(low, high)), 3)

    period, angle, x = number(0.15, 0.35), number(-1.5, 1.5), 0.0
    table = {"table": [[0.0, period / 2, period], [0.0, number(0.01, 0.03), 0.0]]}
    bodies: dict[str, Any] = {"slide": {"mass": number(0.5, 2.0), "inertia": 0.1}}
    joints: dict[str, Any] = {
        "S": {"type": "prismatic", "bodies": ["ground", "slide"], "points": [[0, 0], [0, 0]], "axis": [1, 0]},
        "D": {
            "type": "driver", "bodies": ["ground", "slide"], "coordinate": "x",
            "motion": {**table, "interpolation": "linear", "ends": "periodic"},
        },
    }  # fmt: skip
    before, at = "slide", np.zeros(2)
    for n in range(1, 3 + int(random.integers(2))):
        half, angle = number(0.1, 0.3), angle + number(-1.0, 1.0)
        middle = at + half * np.array([np.cos(angle), np.sin(angle)])
        mass = number(0.3, 2.0)
        bodies[f"rod{n}"] = {
            "mass": mass, "inertia": round(mass * half**2 / 3 + 1e-3, 6), "position": middle.tolist(), "angle": angle
        }  # fmt: skip
        joints[f"P{n}"] = {"type": "revolute", "bodies": [before, f"rod{n}"], "at": at.tolist()}
        before, at = f"rod{n}", middle + (middle - at)
    x = number(0.02, 0.1)
    states = {
        "current": {"rate": f"(sin({number(5, 20)}*t) - states.current)/{x} - 0.1*joints.P1.angle"},
        "charge": {"rate": f"{number(6, 12)} - states.charge"},
    }
    forces: dict[str, Any] = {
        "motor": {"type": "torque", "body": "rod1", "value": f"{number(0.1, 0.5)}*states.current"},
        "pulses": {"type": "torque", "body": "rod2", "value": f"{number(0.05, 0.2)}*states.charge"},
        "drag": {"type": "torque", "body": "rod2", "value": f"-{number(0.05, 0.2)}*rod2.angular_velocity"},
    }
    model: dict[str, Any] = {
        "name": "mechanism", "bodies": bodies, "joints": joints, "forces": forces, "states": states,
    }  # fmt: skip
    if random.random() < 0.5:
        held = {"torque": {"period": number(0.02, 0.06), "outputs": {"held": f"-{number(0.1, 0.5)}*joints.P1.angle"}}}
        model["controllers"] = held
        forces["held"] = {"type": "torque", "body": "rod1", "value": "controllers.torque.held"}
    events = {
        "fires": {"when": "states.charge - 1", "direction": "rising", "set": {"charge": "0.1*states.charge"}},
        "turns": {"when": "rod1.angular_velocity"},
    }
    given = {"mbdkit": 1, "model": model, "events": events, "impacts": "allow"}
    if random.random() < 0.5:
        bodies["ball"] = {
            "mass": number(0.2, 1.0), "inertia": 0.004, "position": [0.0, number(-0.8, -0.4)],
            "velocity": [number(-1, 1), number(-2, 0)],
        }  # fmt: skip
        floor = {"line": {"point": [0.0, -1.0], "normal": [0.0, 1.0]}}
        model["contacts"] = {
            "floor": {
                "bodies": ["ground", "ball"], "shapes": [floor, {"circle": {"radius": 0.1}}],
                "friction": number(0.1, 0.6), "restitution": number(0.5, 0.9),
            }
        }  # fmt: skip
        return given | {"contact": {"treatment": "event-driven"}}  # every step projects then
    return given | {"stabilization": ("none", "projection")[int(random.integers(2))]}


def _spec(given: dict[str, Any], like: str, step: float = STEP) -> dict[str, Any]:
    name = {"name": _installed()[like]}
    if like in CONTROLLED:
        integrator, time = name | {"rtol": 1e-8, "atol": 1e-10}, {"end": END}
    else:
        integrator, time = name, {"end": END, "step": step}
    formulation = {"formulation": "ggl"} if like == "dae" else {}
    return {**given, "integrator": integrator, "time": time, **formulation}


def _last(run: mbdkit.Run) -> np.ndarray:
    parts = [np.append(body.position[-1], body.angle[-1]) for body in run.bodies.values()]
    return np.concatenate([*parts, [run.states[name].value[-1] for name in ("current", "charge")]])


def compare(random: np.random.Generator, folder: Path) -> list[str]:
    """Run all templates on one mechanism, and compare them with DOP853."""
    given = drawn(random)
    exact = mbdkit.run({**given, "integrator": EXACT, "time": {"end": END}}).check()
    wanted, fired, wrong = _last(exact), exact.events.of_name("fires").time, []
    for like in _installed():
        steps = (STEP,) if like in CONTROLLED else (STEP, STEP / 2)
        runs = [mbdkit.run(_spec(given, like, step)) for step in steps]
        if ended := [run.status_reason for run in runs if run.status != "complete"]:
            wrong.append(f"{like}: {ended[0]}")
            continue
        errors = [float(np.abs(_last(run) - wanted).max()) for run in runs]
        times = runs[-1].events.of_name("fires").time
        if len(times) != len(fired) or not np.allclose(times, fired, rtol=0, atol=1e-3):
            wrong.append(f"{like}: events at {times.tolist()} instead of {fired.tolist()}")
        elif like in CONTROLLED and errors[0] > CONTROLLED[like]:
            wrong.append(f"{like}: its error is {errors[0]:.3g}")
        elif like not in CONTROLLED and errors[1] > max(SMALL, FALLS * errors[0]):
            wrong.append(f"{like}: its error falls from {errors[0]:.3g} to {errors[1]:.3g} only")
    return wrong


def kill(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill runs of all templates, and resume them."""
    given, wrong = drawn(random), []
    for like in _installed():
        spec = _spec(given, like, STEP / 4)
        whole, part = mbdkit.run(spec), folder / f"{like}.h5.part"
        if not killed(spec, part, checkpoints=int(random.integers(1, 4))):
            continue  # it was faster
        resumed = mbdkit.resume(part)
        if resumed.data_sha256 != whole.data_sha256:
            wrong.append(f"{like}: resumed, its run has other bits")
    return wrong


ATTACKS = (
    Attack("methods", "methods from the templates on random mechanisms: as right as DOP853", 40, compare),
    Attack("methods-killed", "SIGKILL to runs of methods from the templates: resumed, they have equal bits", 20, kill),
)
