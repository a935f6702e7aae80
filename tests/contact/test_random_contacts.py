"""Random mechanisms with rigid contacts; `python -m tests.benchmarks.contact_mechanisms` has many more."""

from __future__ import annotations

import pytest

from tests.contact.random_contacts import examined


@pytest.mark.parametrize("seed", [8, 20, 28, 98])
def test_random_contacts_keep_their_laws(seed: int) -> None:
    assert examined(seed, compare=False).faults == []


def test_both_treatments_converge_to_the_same_motion() -> None:
    found = examined(27)
    assert found.faults == []
    assert found.known == 1.0
