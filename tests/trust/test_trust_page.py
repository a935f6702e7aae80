"""The page on trust has the limits of the criteria, and a row for every run that its command makes."""

from __future__ import annotations

from pathlib import Path

import mbdkit
from tests.benchmarks.trust_page import SETTINGS, page
from tests.witness.known_motions import known_motions

PAGE = (Path(mbdkit.__file__).parent / "guide" / "trust.md").read_text(encoding="utf-8")


def test_the_page_is_that_of_its_generator_whatever_was_measured() -> None:
    # otherwise run: python -m tests.benchmarks.trust_page mbdkit/guide/trust.md
    table = PAGE.partition("|---|---|---|---|---|---|---|---|\n")[2].splitlines()
    assert page(table) == PAGE


def test_the_page_has_rows_for_every_known_motion() -> None:
    for known in known_motions():
        assert PAGE.count(f"\n| {known.name} | ") == len(SETTINGS)


def test_no_run_of_the_page_with_wrong_forces_is_good() -> None:
    rows = [line.strip("| ").split(" | ") for line in PAGE.partition("## Measured errors")[2].splitlines()]
    good = [row for row in rows if row[-1] == "good"]
    assert len(good) > 40
    assert all(float(row[4]) <= 0.05 for row in good)
