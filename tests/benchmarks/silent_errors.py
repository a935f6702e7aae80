"""Sweeps that look for runs which are wrong without a word: complete, not flagged by their verdict, and wrong.

``python -m tests.benchmarks.silent_errors [KIND ...] [--runs N] [--seed S]`` draws runs of four kinds:

``stiff``
    Stiff springs and bushings under adaptive implicit methods; expected: the motion of a rigid pendulum.
``fixed``, ``adaptive``
    Linkages through singular positions; expected: the cranks of parallel linkages stay parallel, and crank and rod of a
    slider-crank with equal lengths stay mirror images.
``parting``
    Parallelograms with two driven cranks whose motions part in two thirds of the draws; expected: both cranks follow
    their motions.

For each kind it prints how many runs were right, how many right ones were flagged or stopped, how many wrong ones were
flagged or stopped, and how many were silent; and it lists all silent ones and all false alarms.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from tests.trust.mechanisms import spec, two_cranks
from tests.trust.stiff_rods import HOLDS, METHODS, tilt_after_a_second

LIMITS = {"wall_time": 10.0}
CLEAN = 1e-3
"""A run is right if its angles or positions are as expected within this, or ten tolerances."""

IMPLICIT = (("gauss", 2), ("gauss", 3), ("radau-iia", 2), ("radau-iia", 3), ("radau-iia", 5))


def _stiff(random: np.random.Generator) -> tuple[dict[str, Any], str, dict[str, float]]:
    stiffness = 10 ** random.uniform(6, 11)
    damping = 0.0 if random.random() < 0.3 else 10 ** random.uniform(0, 5)
    (name, stages), hold = METHODS[random.integers(len(METHODS))], ("spring", "bushing")[random.integers(2)]
    tolerance = 10 ** random.uniform(-8, -3)
    integrator = {"name": name, "stages": stages, "adaptive": True, "rtol": tolerance}
    model = HOLDS[hold][0](stiffness, damping)
    return spec(model, integrator, 1.0, limits=LIMITS), hold, {"limit": CLEAN + 20 * tolerance + 1e3 / stiffness}


def _linkage(random: np.random.Generator, *, adaptive: bool) -> tuple[dict[str, Any], str, dict[str, float]]:
    integrator: dict[str, Any]
    if adaptive and random.random() < 0.5:
        integrator = {"name": ("dopri5", "dop853")[random.integers(2)]}
    else:
        name, stages = IMPLICIT[random.integers(len(IMPLICIT))]
        integrator = {"name": name, "stages": stages}
    step = None if adaptive else 10 ** random.uniform(-3, -1.8)
    if adaptive:
        integrator |= {"adaptive": True, "rtol": 10 ** random.uniform(-9, -3)}
    if random.random() < 0.6:
        kind, n = "parallel", int(random.integers(1, 3))
        model = {"name": "n-four-bar", "n": n, "speed": random.uniform(0.5, 3.0), "angle": random.uniform(0.6, 2.5)}
        return spec(model, integrator, 10.0, step, limits=LIMITS), kind, {"limit": 0.05, "n": n}
    return spec(_slider(random), integrator, 5.0, step, limits=LIMITS), "slider", {"limit": 0.05}


def _slider(random: np.random.Generator) -> dict[str, Any]:
    """Return a slider-crank with a crank as long as its rod, and the crank's speed."""
    length, angle, rate = random.uniform(0.5, 1.0), random.uniform(0.2, 1.2), random.uniform(-9, 9)
    masses = random.uniform(0.5, 2.0, 3)
    cosine, sine = math.cos(angle), math.sin(angle)
    rod = {"inertia": 0.1}
    half = length / 2
    bodies = {
        "crank": {
            **rod, "mass": masses[0], "position": [half * cosine, half * sine], "angle": angle,
            "velocity": [-half * sine * rate, half * cosine * rate], "angular_velocity": rate,
        },
        "rod": {
            **rod, "mass": masses[1], "position": [3 * half * cosine, half * sine], "angle": -angle,
            "velocity": [-3 * half * sine * rate, half * cosine * rate], "angular_velocity": -rate,
        },
        "slider": {
            "mass": masses[2], "inertia": 1.0, "position": [4 * half * cosine, 0.0],
            "velocity": [-4 * half * sine * rate, 0.0],
        },
    }  # fmt: skip
    pins = {
        "O": (["ground", "crank"], [[0, 0], [-half, 0]]),
        "P": (["crank", "rod"], [[half, 0], [-half, 0]]),
        "Q": (["rod", "slider"], [[half, 0], [0, 0]]),
    }
    joints: dict[str, Any] = {
        name: {"type": "revolute", "bodies": held, "points": points} for name, (held, points) in pins.items()
    }
    joints["S"] = {"type": "prismatic", "bodies": ["ground", "slider"], "points": [[0, 0], [0, 0]], "axis": [1, 0]}
    gravity = [0.0, -9.81 if random.random() < 0.5 else 0.0]
    return {"name": "mechanism", "gravity": gravity, "bodies": bodies, "joints": joints}


def _parting(random: np.random.Generator) -> tuple[dict[str, Any], str, dict[str, float]]:
    speed, begin, power = random.uniform(0.2, 1.0), random.uniform(0.05, 1.0), int(random.integers(2, 5))
    amount = 0.0 if random.random() < 1 / 3 else 10 ** random.uniform(-2, 1)
    first = f"0.7+{speed!r}*t"
    part = f"+{amount!r}*max(0,t-{begin!r})**{power}" if amount else ""
    name = ("rk4", "rk-gill", "dopri5", "gauss", "radau-iia")[random.integers(5)]
    step = 10 ** random.uniform(-3, -1)
    sweep = spec(two_cranks(first + part, first), {"name": name}, 2.0, step, limits=LIMITS)
    return sweep, "parting", {"limit": CLEAN, "speed": speed, "begin": begin, "power": power, "amount": amount}


DRAWS = {
    "stiff": _stiff,
    "fixed": lambda random: _linkage(random, adaptive=False),
    "adaptive": lambda random: _linkage(random, adaptive=True),
    "parting": _parting,
}


def _error(run: Any, kind: str, facts: dict[str, float]) -> float:
    """Return the error of a run over its rows."""
    position = run.dataset("trajectory/position")[:]
    if kind in HOLDS:
        _, length, pull = HOLDS[kind]
        tilt = tilt_after_a_second(pull)
        x, y = position[-1, 0, :2]
        return math.hypot(x - length * math.cos(tilt), y - length * math.sin(tilt))
    if kind == "parallel":
        cranks = position[:, : int(facts["n"]) + 1, 2]
        return float(np.max(np.abs(cranks - cranks[:, :1])))
    if kind == "slider":
        return float(np.max(np.abs(position[:, 0, 2] + position[:, 1, 2])))
    t = run.time[:]
    first = 0.7 + facts["speed"] * t
    second = first + facts["amount"] * np.maximum(0.0, t - facts["begin"]) ** facts["power"]
    return float(max(np.max(np.abs(position[:, 0, 2] - first)), np.max(np.abs(position[:, 1, 2] - second))))


def _outcome(job: tuple[str, int, int]) -> tuple[str, str]:
    """Return the outcome of a draw, and what it was."""
    import mbdkit

    sweep, seed, number = job
    random = np.random.default_rng([seed, number, sorted(DRAWS).index(sweep)])
    source, kind, facts = DRAWS[sweep](random)
    run = mbdkit.run(source)
    error = _error(run, kind, facts)
    right = error <= facts["limit"]
    told = f"{number}: {kind} {source['integrator']} {source['time']} error {error:.3g}, "
    told += f"{run.status} {run.status_reason} {run.verdict} {run.verdict_reasons}"
    if run.status != "complete":
        if run.status_reason.startswith("wall-time"):
            return "out of time", told
        agrees = sweep == "parting" and facts["amount"] == 0.0
        guarded = run.status_reason.startswith(("fell-apart", "energy-jump", "branch-left")) or agrees
        return ("right, stopped by a guard" if right and guarded else "stopped"), told
    alarm = run.verdict in ("doubtful", "bad")
    if right:
        return ("right, flagged" if alarm and _is_clean(run) else "right"), told
    return ("wrong, flagged" if alarm else "WRONG, SILENT"), told


def _is_clean(run: Any) -> bool:
    """Return whether joints and energy of a run are good, so that an alarm is false."""
    balance, kinetic = run.energy.balance, run.energy.kinetic
    gap = max(joint.misalignment_max for joint in run.joints.values()) if run.joints else 0.0
    return float(np.max(np.abs(balance))) < CLEAN * float(np.max(kinetic)) and gap < 1e-4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("kinds", nargs="*", default=[], metavar="KIND", help=f"of {', '.join(DRAWS)}; default: all")
    parser.add_argument("--runs", type=int, default=100, help="number of runs of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    if unknown := set(options.kinds) - set(DRAWS):
        parser.error(f"there is no kind {', '.join(sorted(unknown))}; known: {', '.join(DRAWS)}")
    for kind in options.kinds or DRAWS:
        jobs = [(kind, options.seed, number) for number in range(options.runs)]
        with ProcessPoolExecutor(options.workers) as pool:
            outcomes = list(pool.map(_outcome, jobs, chunksize=5))
        counts = Counter(outcome for outcome, _ in outcomes)
        print(f"{kind}: " + ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())), flush=True)
        for outcome, told in outcomes:
            if outcome in ("WRONG, SILENT", "right, flagged", "right, stopped by a guard"):
                print(f"  {outcome}: {told[:400]}", flush=True)


if __name__ == "__main__":
    main()
