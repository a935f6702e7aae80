"""`python -m tests.benchmarks.contact_errors [--count N] [--time-stepping N] [--seed S]`: error bars of bouncing discs.

Random discs on springs bounce from lines and from each other (`tests.witness.bouncing`). The estimated errors of
positions and velocities of event-driven runs, and of a few by time-stepping, are compared with the true ones.
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.witness.bouncing import METHODS, Compared, Discs, compared


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--time-stepping", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    heads = "runs  impacts  known    values  covered   least    most"
    print(f"{'method':<12} {heads}")
    for name in METHODS:
        count = given.time_stepping if name == "moreau-jean" else given.count
        found: list[Compared] = []
        for k in range(count):
            one = compared(Discs.drawn(np.random.default_rng([given.seed, k])), name, end=2.0)
            found.append(one)
            if one.covered < 0.95:
                print(f"    system {k}: {one.covered:.1%} covered, largest ratio {np.max(one.ratios):.3g}", flush=True)
        ratios = np.concatenate([one.ratios for one in found])
        covered = np.mean([one.covered for one in found])
        known, impacts = np.mean([one.known for one in found]), sum(one.impacts for one in found)
        low, high = (float(pick(ratios, initial=1.0)) for pick in (np.min, np.max))
        figures = f"{len(ratios):>9} {covered:>8.2%} {low:>7.3g} {high:>7.3g}"
        print(f"{name:<12} {count:>4} {impacts:>8} {known:>6.0%} {figures}", flush=True)


if __name__ == "__main__":
    main()
