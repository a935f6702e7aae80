"""Attack mbdkit as a hostile or unlucky world would: `python -m tests.campaign [ATTACK ...]`.

Without options this is the whole campaign, which takes hours. ``--share 0.01`` makes a hundredth of the cases of each
attack, at least one, and large cases a hundredth as large; ``--processes 2`` makes two cases at a time. Every case is
repeated exactly by ``ATTACK --seed S --case INDEX``. The exit status is 1 if anything did not hold.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import math
import pkgutil
import sys
import tempfile
import time
import traceback
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import tests.campaign

from . import size_attacks
from .attack import Attack


def attacks() -> dict[str, Attack]:
    """Return all attacks by name, from the files of this folder that have a constant `ATTACKS`."""
    found: dict[str, Attack] = {}
    for module in sorted(pkgutil.iter_modules(tests.campaign.__path__), key=lambda module: module.name):
        if not module.name.startswith(("_", "test_")):
            for attack in getattr(importlib.import_module(f"tests.campaign.{module.name}"), "ATTACKS", ()):
                found[attack.name] = attack
    return found


def problems(name: str, seed: int, index: int, size: float = 1.0) -> list[str]:
    """Return what did not hold in one case, made in a folder of its own."""
    attack = attacks()[name]
    size_attacks.SIZE = size
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        try:
            return attack.case(attack.random(seed, index), Path(folder))
        except Exception:  # it did not hold in a way that the attack does not foresee; the next cases go on
            return [f"the attack ended with {traceback.format_exc()}"]


def main() -> None:
    """Make the attacks that are asked for, and print what did not hold."""
    every = attacks()
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__.split("\n")[0])
    parser.add_argument("attacks", nargs="*", help=f"{', '.join(every)}; all by default")
    parser.add_argument("--share", type=float, default=1.0, help="share of the cases of each attack; 1 by default")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random numbers; 1 by default")
    parser.add_argument("--case", type=int, help="make this case alone")
    parser.add_argument("--processes", type=int, default=1, help="cases made at a time; 1 by default")
    parser.add_argument("--list", action="store_true", help="list the attacks and their numbers of cases")
    asked = parser.parse_args()
    for name in asked.attacks:
        if name not in every:
            parser.error(f"no attack is called {name!r}; there are {', '.join(every)}")
    chosen = [every[name] for name in asked.attacks or every]
    if asked.list:
        for attack in chosen:
            print(f"{attack.name:16}{attack.cases:7}  {attack.summary}")
        return
    failed = 0
    for attack in chosen:
        if attack.obstacle:
            print(f"{attack.obstacle}.", flush=True)
            continue
        cases = range(max(1, math.ceil(attack.cases * asked.share))) if asked.case is None else [asked.case]
        start, found = time.monotonic(), 0
        case = functools.partial(problems, attack.name, asked.seed, size=min(1.0, asked.share))
        with ProcessPoolExecutor(asked.processes) as pool:
            for index, sentences in zip(cases, pool.map(case, cases), strict=True):
                found += bool(sentences)
                for sentence in sentences:
                    print(f"  {attack.name} --seed {asked.seed} --case {index}: {sentence}", flush=True)
        held = len(cases) - found
        print(f"{attack.name:16} {held} of {len(cases)} held, {time.monotonic() - start:.0f} s", flush=True)
        failed += found
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
