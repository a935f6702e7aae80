"""`python -m tests.benchmarks.pit [--steps N] [--step H]`: speed of time-stepping with 100 circles in a pit.

Prints the rate, in steps times closed contacts a second of processor time, over parts of the run.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import mbdkit
from mbdkit.methods.step_methods import StepState
from mbdkit_contact.time_stepping import TimeStepping
from tests.witness.pit import pit

PARTS = 10


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--step", type=float, default=1e-3)
    given = parser.parse_args()
    taken: list[float] = []
    step = TimeStepping.step

    def timed(self: TimeStepping, *arguments: Any) -> StepState:
        begin = time.process_time()
        state = step(self, *arguments)
        taken.append(time.process_time() - begin)
        return state

    TimeStepping.step = timed  # type: ignore[method-assign]
    every = max(1, given.steps // PARTS)
    run = mbdkit.run(pit(10, 10), time={"step": given.step, "steps": given.steps}, output={"every": every})
    gap = run.array("contacts/gap")
    print(f"{run.status}; deepest overlap {max(0.0, -float(np.min(gap))):.2g} m; {list(run.warnings)}")
    for part in range(PARTS):
        median = float(np.median(taken[part * every : (part + 1) * every]))
        closed = int(np.sum(np.abs(gap[part + 1]) < 1e-5))
        rate = f"{1e3 * median:.2f} ms a step, {closed / median:.3g} a second"
        print(f"t = {run.time[part + 1]:.3f} s: {closed:>4} closed, {rate}")


if __name__ == "__main__":
    main()
