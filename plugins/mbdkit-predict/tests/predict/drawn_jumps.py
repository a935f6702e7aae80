"""Drawn loads that jump in the position, the velocity or the time; run as a script, compares predictions with
`switching: auto` with optima in closed form.

    PYTHONPATH=plugins/mbdkit-predict/tests python -m predict.drawn_jumps [NUMBER ...]

A block of 1 kg moves from a state to another one with the least integral of the squared force. While it does not pass a
jump, the load is constant and the optimum a cubic polynomial of time; the times and states at the jumps are those of
the least effort, by Nelder and Mead's method from many starts.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

import mbdkit
from predict.exact_optima import block

COUNT, STARTS = 20, 12
KINDS = "place", "speed", "time", "two places"


def effort_of_phases(ends: Any, states: Any, loads: Any, first: tuple[float, float] = (0.0, 0.0)) -> float:
    """Return the least effort of 1 kg that passes states (x, v) at the ends of phases with constant loads."""
    total, begin, (place, speed) = 0.0, 0.0, first
    for end, (x, v), load in zip(ends, states, loads, strict=True):
        h = end - begin
        if h <= 1e-9:
            return np.inf
        way, change = x - place - speed * h - 0.5 * load * h**2, v - speed - load * h
        total += 12 * way**2 / h**3 - 12 * way * change / h**2 + 4 * change**2 / h
        begin, place, speed = end, x, v
    return total


def least(effort: Any, guesses: Any) -> float:
    """Return the smallest minimum of an effort from several guesses."""
    options = {"xatol": 1e-11, "fatol": 1e-14, "maxiter": 20_000, "maxfev": 20_000}
    return min(float(minimize(effort, guess, method="Nelder-Mead", options=options).fun) for guess in guesses)


@dataclass(frozen=True)
class DrawnJump:
    """A drawn load, its spec, and the least effort."""

    kind: str
    spec: dict[str, Any]
    optimum: float


def drawn_jump(number: int) -> DrawnJump:
    """Return a problem; those from 0 to `COUNT` - 1 are the test."""
    random = np.random.default_rng([92, number])
    kind, end = KINDS[number % len(KINDS)], float(random.uniform(0.6, 1.8))
    before, after = (random.uniform(-1.0, 1.0, 2) * 6.0 / end**2).tolist()
    steep = 10.0 ** random.uniform(6, 9)

    def jump(at: str, size: float) -> str:
        """Return a load that jumps by a size where an expression becomes positive: three ways to write it, one for
        times, which are no jumps of the state.
        """
        ways = (f"{0.5 * size}*(1 + tanh({steep}*({at})))", f"{0.5 * size}*(1 + ({at})/abs({at}))",
                f"{size}*max(0, min(1, {steep}*({at})))")  # fmt: skip
        return ways[0 if kind == "time" else int(random.integers(3))]

    first, sections = (0.0, 0.0), dict[str, Any]()
    if kind == "place":
        at = float(random.uniform(0.2, 0.8))
        value = f"{before} + {jump(f'block.x - {at}', after - before)}"
        guesses = [(end * s, random.uniform(0.2, 3.0) / end) for s in random.uniform(0.1, 0.9, STARTS)]
        optimum = least(lambda y: effort_of_phases([y[0], end], [(at, y[1]), (1.0, 0.0)], [before, after]), guesses)
    elif kind == "speed":
        first = (0.0, -float(random.uniform(0.3, 1.5)))  # dry friction: the velocity changes its sign once
        force = float(random.uniform(0.5, 4.0))
        value = f"{force} - {jump('block.vx', 2.0 * force)}"
        guesses = [(end * s, x) for s in random.uniform(0.05, 0.7, STARTS) for x in (-0.1, -0.4)]
        optimum = least(
            lambda y: effort_of_phases([y[0], end], [(y[1], 0.0), (1.0, 0.0)], [force, -force], first), guesses
        )
        sections["initial"] = {"block.x": 0, "block.vx": first[1]}
    elif kind == "time":
        at = end * float(random.uniform(0.2, 0.8))
        value = f"{before} + {jump(f't - {at}', after - before)}"
        guesses = [(x, 1.5 * x) for x in random.uniform(0.1, 0.9, STARTS)]
        optimum = least(lambda y: effort_of_phases([at, end], [(y[0], y[1]), (1.0, 0.0)], [before, after]), guesses)
    else:
        low, high = sorted(random.uniform([0.15, 0.55], [0.45, 0.85]).tolist())
        value = f"{jump(f'block.x - {low}', before)} + {jump(f'block.x - {high}', after)}"
        guesses = [(end * a, end * b, 1.0 / end, 1.0 / end) for a, b in np.sort(random.uniform(0.1, 0.9, (STARTS, 2)))]
        optimum = least(
            lambda y: effort_of_phases(
                [y[0], y[1], end], [(low, y[2]), (high, y[3]), (1.0, 0.0)], [0.0, before, before + after]
            ),
            guesses,
        )
    load = {"load": {"type": "force", "body": "block", "value": [value, 0]}}
    spec = block(forces=load, duration=end, switching="auto", limits={"wall_time": 60}, **sections)
    return DrawnJump(kind, spec, optimum)


def word_of(run: mbdkit.Run, optimum: float) -> str:
    """Return ``right``, ``told`` or ``silent``."""
    is_right = abs(run.objective - optimum) <= run.objective_error + 1e-9 * abs(optimum)
    if run.verdict == "good" and run.status == "complete":
        return "right" if is_right else "silent"
    return "told"


def main() -> None:
    """Print the table."""
    words = dict[str, int]()
    for number in [int(x) for x in sys.argv[1:]] or range(COUNT):
        problem, begin = drawn_jump(number), time.perf_counter()
        run = mbdkit.predict(problem.spec)
        word = word_of(run, problem.optimum)
        words[word] = words.get(word, 0) + 1
        reason = "" if word == "right" else (run.status_reason or run.verdict_reasons[0])[:110]
        print(
            f"{number:>3} {problem.kind:<10} {problem.optimum:15.9g} {run.objective:15.9g} "
            f"+- {run.objective_error:7.1e} {time.perf_counter() - begin:5.1f} s {word} {reason}", flush=True,
        )  # fmt: skip
    print(", ".join(f"{word} {count}" for word, count in words.items()))


if __name__ == "__main__":
    main()
