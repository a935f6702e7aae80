"""`python -m tests.benchmarks.measure_errors [--count 200]`: errors and gradients of measures beside the truth.

Random chains (`tests.witness.chain_measures`), each with 9 measures, of which 5 have kinks or are extrema. Printed are
the shares of estimated errors, of values and of derivatives, that are between 1/5 and 3 times the true error; then all
others.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from tests.witness.chain_measures import Case, cases_of


def told(cases: list[Case]) -> str:
    """Return the shares and the exceptions as text."""
    known = [one for one in cases if one.is_known]
    inside, right = (np.mean([good(one) for one in some]) for good, some in (
        (lambda one: one.is_inside, known), (lambda one: one.is_right, cases),
    ))  # fmt: skip
    first = (
        f"{len(cases)} measures: errors of {len(known)} are estimated, {100 * inside:.1f} % of them between 1/5 and 3 "
        f"times the true error; {100 * right:.1f} % of the estimated errors of derivatives are"
    )
    others = [
        f"  chain {one.seed} ({one.method}) {one.measure}: error {abs(one.value - one.exact):.2g}, estimate "
        f"{one.estimate:.2g}; derivative {one.derivative:.9g} +- {one.derivative_estimate:.2g}, "
        f"exact {one.exact_derivative:.9g}"
        for one in cases
        if (one.is_known and not one.is_inside) or not one.is_right
    ]
    return "\n".join([first, *others])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first chain")
    given = parser.parse_args()
    found: list[Case] = []
    for seed in range(given.first, given.first + given.count):
        found += cases_of(seed)
        print(f"\r{seed + 1 - given.first} of {given.count} chains", end="", file=sys.stderr, flush=True)
    print(told(found))
