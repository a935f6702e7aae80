"""Share of true torques and joint forces that the error bars of inverse dynamics cover.

``python -m tests.benchmarks.inverse_coverage [--mechanisms N] [--first N] [--noises N] [--workers N]`` draws random
mechanisms, chains and closed loops with as many or more columns than degrees of freedom, and compares them with forward
runs whose drivers prescribe the motion: once with the coordinates that mbdkit chooses, and once with random ones. Three
packaged closed loops follow.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from tests.inverse_dynamics.moved_linkages import moved
from tests.inverse_dynamics.noisy import CUTOFF, Truth, covered

from tests.benchmarks.drawn_coverage import coverage


def main() -> None:
    """Print the shares of each mechanism and their means."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.inverse_coverage")
    parser.add_argument("--mechanisms", type=int, default=48)
    parser.add_argument("--first", type=int, default=0, help="number of the first mechanism")
    parser.add_argument("--noises", type=int, default=20, help="samples of the noise for each mechanism")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.workers) as pool:
        for random_coordinates in (False, True):
            print("random coordinates" if random_coordinates else "coordinates as chosen")
            one = partial(coverage, noises=asked.noises, random_coordinates=random_coordinates)
            found = list(pool.map(one, range(asked.first, asked.first + asked.mechanisms)))
            for number, each in enumerate(found, asked.first):
                print(f"  {number:3} {each.label}: {np.mean(each.torques):.1%}, {np.mean(each.forces):.1%}")
            torques, forces = (np.concatenate([getattr(one, name) for one in found]) for name in ("torques", "forces"))
            print(f"mean of {torques.size} actuators {torques.mean():.1%}, of {forces.size} joints {forces.mean():.1%}")
    for example, cutoff in CUTOFF.items():
        with tempfile.TemporaryDirectory() as folder:
            run, spec = moved(example, Path(folder) / "run.h5")
            of_torques, of_forces = covered(Truth.of(example, run, spec["actuators"]), spec, cutoff, asked.noises)
        told = ", ".join(f"{name} {share:.1%}" for name, share in zip(spec["actuators"], of_torques, strict=True))
        print(f"{example}, {cutoff:g} Hz: {told}; joint forces {of_forces.min():.1%} to {of_forces.max():.1%}")


if __name__ == "__main__":
    main()
