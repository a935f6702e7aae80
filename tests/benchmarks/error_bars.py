"""`python -m tests.benchmarks.error_bars [PROBLEM ...]`: estimated against true errors, as a table."""

from __future__ import annotations

import sys

import numpy as np

from tests.witness.error_bars import (
    ASKED,
    FACTORS,
    FIXED,
    HIGH,
    NEVER,
    TOLERANCES,
    Case,
    Truth,
    run_asked,
    run_case,
    share_inside,
)
from tests.witness.known_motions import known_motions


def line(name: str, cases: list[Case]) -> str:
    """Return a line of the table."""
    ratios = np.concatenate([case.ratios for case in cases])
    low, high = (float(pick(ratios)) if len(ratios) else np.nan for pick in (np.min, np.max))
    known = np.mean([np.nan_to_num(case.known_until) / case.end if case.end else 0.0 for case in cases])
    wrong = sum(case.good and case.worst_true_share > 0.05 for case in cases)
    good = sum(case.good for case in cases)
    return (
        f"{name:<26} {len(cases):>4} {known:>6.0%} {len(ratios):>8} {share_inside(cases):>8.2%} {low:>8.3g} "
        f"{high:>8.3g} {int(np.sum(ratios > NEVER)):>6} {good:>5} {wrong:>6}"
    )


def main() -> None:
    """Print the table."""
    wanted = sys.argv[1:]
    every: list[Case] = []
    heads = ("runs", 4), ("known", 6), ("values", 8), ("inside", 8), ("least", 8), ("most", 8), (">10", 6), ("good", 5)
    print(f"{'problem':<26} " + " ".join(f"{head:>{width}}" for head, width in (*heads, ("wrong", 6))))
    for known in known_motions():
        if wanted and known.name not in wanted:
            continue
        truth = Truth(known)
        cases = [run_case(truth, method, factor) for method in FIXED for factor in FACTORS]
        cases += [run_case(truth, "dop853", tolerance) for tolerance in TOLERANCES]
        cases += [run_asked(truth, asked) for asked in ASKED]
        every += cases
        print(line(known.name, cases), flush=True)
        for case in cases:
            if wanted or share_inside([case]) < 0.95 or np.any(case.ratios > HIGH):
                print(
                    f"    {case.method:<12} {case.setting:<8.3g} {case.status:<9} until {case.known_until:.4g} of "
                    f"{case.end:.4g} s, inside {share_inside([case]):.1%}, good {case.good}, true share "
                    f"{case.worst_true_share:.2g}; worst {case.where}",
                    flush=True,
                )
    print(line("all", every))
    for method in [*FIXED, "dop853", "asked"]:
        print(line(method, [case for case in every if case.method == method]))


if __name__ == "__main__":
    main()
