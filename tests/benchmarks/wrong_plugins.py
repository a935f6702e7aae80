"""How many wrong plugins the conformance kit refuses, and how many right ones.

``python -m tests.benchmarks.wrong_plugins`` runs, on each wrong plugin of `tests.testing.test_corpus`, the check that
must fail. It verifies the right ones beside them, and all built-in plugins, completely; ``--quick``: by quick checks.
"""

from __future__ import annotations

import argparse
import time

from tests.testing.corpus_of_wrong_plugins import RIGHT, WRONG, outcome

from mbdkit.base.errors import SpecError
from mbdkit.registry.manager import registry
from mbdkit_testing import verify


def main() -> None:
    """Print wrong plugins that are not refused, right ones that are, and the counts and times of both."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.wrong_plugins")
    parser.add_argument("--quick", action="store_true", help="run the quick checks of right plugins")
    quick = parser.parse_args().quick
    begin, refused = time.perf_counter(), 0
    for name, (kind, installed, check) in WRONG.items():
        is_refused = outcome(kind, installed, check).outcome == "fail"
        refused += is_refused
        if not is_refused:
            print(f"not refused by {check}: {name}")
    print(f"{refused} of {len(WRONG)} wrong plugins are refused, in {time.perf_counter() - begin:.0f} s", flush=True)
    right = [(kind, "acme:mine", name, installed) for name, (kind, installed) in RIGHT.items()]
    own = registry().only("mbdkit")
    right += [(item.kind, item.id, item.id, own) for item in own.items]
    failed, count, longest, begin = 0, 0, 0.0, time.perf_counter()
    for kind, plugin, name, installed in right:
        try:
            report = verify(kind, plugin, installed=installed, quick=quick)
        except SpecError as error:
            print(f"left out: {error}")
            continue
        count += 1
        longest = max(longest, report.seconds)
        if not report.verified:
            failed += 1
            print(f"refused: {name}\n{report.text()}")
    took = time.perf_counter() - begin
    print(f"{failed} of {count} right plugins are refused, in {took:.0f} s, {longest:.0f} s at most for one")


if __name__ == "__main__":
    main()
