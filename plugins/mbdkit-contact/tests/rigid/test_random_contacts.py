"""Random mechanisms with rigid contacts; `python -m tests.benchmarks.contact_mechanisms` has many more."""

from __future__ import annotations

import pytest
from tests.rigid.random_contacts import HILLS, STEP, computed, drawn, examined, positions

from tests.margins import assert_within


@pytest.mark.parametrize("seed", [8, 20, 28, 98])
def test_random_contacts_keep_their_laws(seed: int) -> None:
    assert examined(seed, compare=False).faults == []


@pytest.mark.parametrize("seed", [0, 1, 5, 6, 7])
def test_bodies_on_uneven_ground_keep_the_laws_of_contact_and_treatments_converge(seed: int) -> None:
    assert examined(seed, kinds=HILLS).faults == []


def test_both_treatments_converge_to_the_same_motion() -> None:
    found = examined(27)
    assert found.faults == []
    assert found.known == 1.0


def test_an_impact_presses_a_contact_that_rests() -> None:
    """At 0.2502 s, one contact of a loop strikes while another one slips: both have impulses, with kinetic friction."""
    model = drawn(47)
    exact = positions(computed(model, "event-driven", STEP, end=0.3))
    for step in (2e-3, 5e-4):  # with these steps, the gap at rest is above zero just before the impact
        coarse = positions(computed(model, "time-stepping", step, end=0.3))
        assert_within(coarse - exact, 5.0 * step)  # margin: error of mbdkit's method at these steps
