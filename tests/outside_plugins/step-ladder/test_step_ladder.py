"""Tests of the study."""

from mbdkit.testing import verify


def test_it_conforms():
    assert verify("study", "step-ladder:step-ladder").verified
