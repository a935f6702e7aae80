"""The verdicts of the packaged examples.

``python -m tests.benchmarks.example_verdicts [--check]`` prints them, with ``--check`` those with estimated errors. Its
exit status is 1 if one is doubtful or bad. Those of the guide are judged by ``python -m pytest tests/test_guide.py
tests/test_plugin_guide.py tests/test_readme.py``.
"""

from __future__ import annotations

import argparse
import sys

import mbdkit
from mbdkit.spec import example_names


def main() -> int:
    """Print a line for each run, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.example_verdicts")
    parser.add_argument("--check", action="store_true", help="estimate the errors of runs")
    check, doubtful = parser.parse_args().check, 0
    names = [
        *((name, mbdkit.run) for name in example_names("run")),
        *((name, mbdkit.inverse) for name in example_names("inverse")),
    ]
    for name, compute in names:
        with compute(name, **({"check": True} if check and compute is mbdkit.run else {})) as run:
            bad = run.verdict not in ("good", "unknown")
            doubtful += bad
            print(f"{name:24} {run.verdict}{': ' + '; '.join(run.verdict_reasons) if bad else ''}", flush=True)
    print(f"{doubtful} of {len(names)} are doubtful or bad")
    return int(doubtful > 0)


if __name__ == "__main__":
    sys.exit(main())
