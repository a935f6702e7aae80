"""Drawn problems with known optima; run as a script, counts those that the error bars of predictions cover.

python plugins/mbdkit-predict/tests/predict/drawn_optima.py [COUNT [SEED]]
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from exact_optima import EFFORT, PUSH, block
from scipy.linalg import expm

import mbdkit

Problem = tuple[dict[str, Any], float]


def linear(random: np.random.Generator) -> Problem:
    """Return a block with spring and damper between drawn states; the least effort follows from the Gramian."""
    mass, stiffness, damping = random.uniform([0.5, 0.0, 0.0], [3.0, 20.0, 3.0])
    end = random.uniform(0.5, 2.0)
    first, last = random.uniform(-2.0, 2.0, (2, 2))
    rates, push = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]]), np.array([[0.0], [1.0 / mass]])
    both = np.block([[-rates, push @ push.T], [np.zeros((2, 2)), rates.T]])
    whole = expm(both * end)  # C. F. Van Loan, IEEE Transactions on Automatic Control 23:395-404, 1978
    missing = last - whole[2:, 2:].T @ first
    effort = missing @ np.linalg.solve(whole[2:, 2:].T @ whole[:2, 2:], missing)
    pull = {"pull": {"type": "force", "body": "block", "value": [f"-{stiffness}*block.x - {damping}*block.vx", 0]}}
    initial, final = (dict(zip(("block.x", "block.vx"), state.tolist(), strict=True)) for state in (first, last))
    controls = {PUSH: {"bounds": [-1e4, 1e4]}}
    return block(mass, pull, duration=end, initial=initial, final=final, controls=controls), float(effort)


def wall(random: np.random.Generator) -> Problem:
    """Return a block that returns before a wall: A. E. Bryson and Y.-C. Ho, Applied Optimal Control (1975), section
    3.11, with other units.
    """
    mass, speed, end = random.uniform([0.5, 0.5, 0.5], [3.0, 2.0, 2.0])
    limit = random.uniform(0.05, 0.24)
    effort = 4.0 / (9.0 * limit) if limit < 1 / 6 else 2.0 + 6.0 * (1.0 - 4.0 * limit) ** 2
    spec = block(
        mass, duration=end, initial={"block.x": 0, "block.vx": speed}, final={"block.x": 0, "block.vx": -speed},
        subject_to={"wall": {"value": "block.x", "max": limit * speed * end}}, minimize=f"0.5*{EFFORT}",
    )  # fmt: skip
    return spec, effort * (mass * speed) ** 2 / end


def quick(random: np.random.Generator) -> Problem:
    """Return a block that moves from rest to rest in the least time, with different limits of both directions."""
    mass, distance, most, least = random.uniform([0.5, 0.5, 5.0, 5.0], [3.0, 2.0, 50.0, 50.0])
    spec = block(
        mass, duration={"bounds": [0.02, 5]}, minimize="final(t)", final={"block.x": distance, "block.vx": 0},
        controls={PUSH: {"bounds": [-least, most]}},
    )  # fmt: skip
    return spec, float(np.sqrt(2.0 * distance * mass * (most + least) / (most * least)))


def drawn(random: np.random.Generator) -> Problem:
    """Return a drawn problem with a drawn method and tolerance, and its optimum."""
    kind = (linear, wall, quick)[random.integers(3)]
    method, points = [("radau", 2), ("radau", 3), ("radau", 5), ("gauss", 2), ("gauss", 3)][random.integers(5)]
    spec, optimum = kind(random)
    collocation = {"method": method, "points": points, "intervals": int(random.integers(4, 25))}
    return spec | {"collocation": collocation, "tolerance": float(10.0 ** random.uniform(-7, -2))}, optimum


def main() -> None:
    """Print the problems that are not covered, and the counts."""
    count, seed = ([int(word) for word in sys.argv[1:]] + [100, 0][len(sys.argv) - 1 :])[:2]
    random, covered, solved, begin, ratios = np.random.default_rng(seed), 0, 0, time.process_time(), []
    for k in range(count):
        spec, optimum = drawn(random)
        run: Any = mbdkit.predict(spec)
        error, bar = abs(run.objective - optimum), run.objective_error
        solved += bool(bar < np.inf)
        covered += bool(error <= bar)
        ratios.append(bar / max(error, 1e-9 * optimum))
        if not error <= bar:
            print(f"{k}: {optimum:.12g}, error {error:.2g}, bar {bar:.2g}, {run.mesh}, {run.status_reason}", spec)
    print(f"{covered} of {solved} solved problems covered, of {count}; median of bar/error {np.median(ratios):.3g}; "
          f"{time.process_time() - begin:.0f} s")  # fmt: skip


if __name__ == "__main__":
    main()
