"""A small share of every attack of the campaign."""

from __future__ import annotations

import os
import re

import pytest

from mbdkit.guide.pages import pages

from .__main__ import attacks, problems

MOST = int(os.environ.get("MBDKIT_CAMPAIGN_CASES", "1"))
"""Largest number of cases of an attack; attacks that have few cases in all take long for each."""


SLOW = {
    *("begin-parts", "block-flips", "bodies", "columns", "dask", "forbidden", "formulas", "kill-blocks", "kill-study"),
    *("kill-worker", "long-run", "members", "methods", "methods-killed", "submitit"),
}
"""Attacks that take many seconds for one case."""


def test_the_guide_lists_every_attack_with_its_number_of_cases() -> None:
    listed: list[str] = []
    for row in pages()["reliability"].text.partition("| promise | attacks | cases |")[2].splitlines()[2:]:
        if not row.startswith("|"):
            break
        _, _, names, count, _ = row.split("|")
        of_row = re.findall("`(.*?)`", names)
        assert sum(attacks()[name].cases for name in of_row) == int(count), row
        listed += of_row
    assert sorted(listed) == sorted(attacks())


@pytest.mark.end_to_end
@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in attacks()])
def test_attack_is_held(name: str) -> None:
    if obstacle := attacks()[name].obstacle:
        pytest.skip(obstacle)
    for index in range(min(MOST, max(1, attacks()[name].cases // 400))):
        assert not problems(name, 20261121, index, size=0.01), (
            f"python -m tests.campaign {name} --seed 20261121 --case {index}"
        )
