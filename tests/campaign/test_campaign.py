"""A small share of every attack of the campaign."""

from __future__ import annotations

import os

import pytest

from .__main__ import attacks, problems

CASES = int(os.environ.get("MBDKIT_CAMPAIGN_CASES", "3"))


@pytest.mark.parametrize("name", attacks())
def test_attack_is_held(name: str) -> None:
    for index in range(CASES):
        assert not problems(attacks()[name], 20261121, index), (
            f"python -m tests.campaign {name} --seed 20261121 --case {index}"
        )
