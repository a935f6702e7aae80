"""Random mechanisms with rigid contacts: what must hold in their runs, and whether the treatments agree.

``python -m tests.benchmarks.contact_mechanisms --count 200`` draws free bodies, chains and closed loops with 1 to 20
contacts, runs each of them event-driven and by time-stepping with three steps, and prints what does not hold; see
`tests.rigid.random_contacts`. With ``--piles``, they are polygons that fall on each other, with ``--hills``
bodies on uneven ground. It ends with status 1 if there is anything.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from tests.rigid.random_contacts import HILLS, KINDS, PILES, STEPS, examined


def main() -> None:
    """Print the mechanisms and a summary."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.contact_mechanisms")
    parser.add_argument("--count", type=int, default=200, help="number of mechanisms")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--law", choices=("newton", "poisson"), default="newton", help="law of impact")
    parser.add_argument("--events", action="store_true", help="do not compare with time-stepping")
    parser.add_argument("--piles", action="store_true", help="draw piles of polygons")
    parser.add_argument("--hills", action="store_true", help="draw bodies on uneven ground")
    asked = parser.parse_args()
    kinds = PILES if asked.piles else HILLS if asked.hills else KINDS
    every = []
    for seed in range(asked.first, asked.first + asked.count):
        found = examined(seed, asked.law, compare=not asked.events, kinds=kinds)
        every.append(found)
        ratios = " ".join(f"{ratio:.3g}" for ratio in found.ratios)
        print(
            f"{seed:>5} {kinds[seed % len(kinds)].__name__:<11} {found.contacts:>3} contacts {found.impacts:>4} impacts"
            f" {'other law' if found.changed else '':<9} known {found.known:4.0%}  {ratios}",
            *(f"    {fault}" for fault in found.faults),
            sep="\n",
            flush=True,
        )
    faulty = sum(bool(found.faults) for found in every)
    print(
        f"{len(every)} mechanisms, {min(one.contacts for one in every)} to {max(one.contacts for one in every)} "
        f"contacts, {sum(one.impacts for one in every)} impacts; another law of impact in "
        f"{sum(one.changed for one in every)}; {faulty} with faults"
    )
    compared = [one for one in every if one.known > 0.0 and one.ratios]
    if compared:
        worst = np.median([one.ratios[: len(STEPS)] for one in compared], axis=0)
        print(
            f"{len(compared)} compared, over {np.mean([one.known for one in compared]):.0%} of their time; median of "
            f"difference over step {' '.join(f'{x:.3g}' for x in worst)} m/s"
        )
    sys.exit(1 if faulty else 0)


if __name__ == "__main__":
    main()
