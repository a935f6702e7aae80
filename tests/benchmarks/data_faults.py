"""How often the verdict of inverse dynamics finds faults in measured data, and how often it doubts clean data.

``python -m tests.benchmarks.data_faults [FAULT ...] [--sets N] [--first N] [--workers N]`` draws data sets, of chains,
closed loops, chains on a force plate and bipeds on two plates, and puts each fault into each of them. It counts

``refused``, ``flagged``
    an error that names the place, or a doubtful verdict;
``same``
    no word, and no result changed by more than its error bar;
``hidden``
    no word, a result changed, and nothing in data and model contradicts the fault;
``silent``
    no word, a result changed, although data or model contradict the fault.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from tests.benchmarks.drawn_faults import FAULTS, outcomes

WORDS = ("refused", "flagged", "same", "hidden", "silent")


def main() -> None:
    """Print the counts, the silent faults, and the doubts about clean data."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.data_faults")
    parser.add_argument("faults", nargs="*", metavar="FAULT", help=f"{', '.join(FAULTS)}; all by default")
    parser.add_argument("--sets", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first data set")
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    chosen = asked.faults or list(FAULTS)
    if unknown := sorted(set(chosen) - set(FAULTS)):
        parser.error(f"there is no fault {unknown[0]!r}")
    with ProcessPoolExecutor(asked.workers) as pool:
        found = []
        for one in pool.map(partial(outcomes, faults=chosen), range(asked.first, asked.first + asked.sets)):
            found.append(one)
            print(f"\r{len(found)} of {asked.sets} sets", end="", file=sys.stderr, flush=True)
    total: Counter[str] = Counter()
    print(f"{'':18}" + "".join(f"{word:>9}" for word in WORDS))
    for fault in chosen:
        counts = Counter(one[fault].word for one in found)
        total += counts
        print(f"{fault:18}" + "".join(f"{counts[word]:9}" for word in WORDS))
        print(
            "".join(f"    {one[fault].number}: {one[fault].told}\n" for one in found if one[fault].word == "silent"),
            end="",
        )
    revealed = total["refused"] + total["flagged"]
    print(f"{revealed} of {revealed + total['silent']} revealing faults that change a result are refused or flagged")
    doubtful = [one[""] for one in found if one[""].word == "flagged"]
    print(f"{len(doubtful)} of {len(found)} clean data sets are doubtful")
    print("".join(f"    {one.number}: {one.told}\n" for one in doubtful), end="")


if __name__ == "__main__":
    main()
