"""The self-test of an installation."""

import json

import pytest

from mbdkit_testing import self_test


def test_the_stored_hashes_belong_to_the_present_code():
    """After a change of the results, ``python -m mbdkit_testing.self_test`` stores the new hashes."""
    assert self_test.hashes() == json.loads(self_test.STORED.read_text())


@pytest.fixture
def other_bits(monkeypatch, tmp_path):
    """Let the stored hashes of two runs, and those of a run that is not there, be others."""
    stored = json.loads(self_test.STORED.read_text())
    del stored["knee"]
    (tmp_path / "other.json").write_text(json.dumps(stored | {"chain": "0" * 64, "gone": "1"}))
    monkeypatch.setattr(self_test, "STORED", tmp_path / "other.json")


def test_runs_with_other_bits_are_named(mbdkit, other_bits):
    outcome = mbdkit("doctor")
    assert outcome.exit_code == 1
    assert "self-test: 2 of 10 runs (knee, chain) have other last bits" in outcome.output


def test_json_says_which_runs_agree(mbdkit, other_bits):
    report = json.loads(mbdkit("doctor", "--json").stdout)
    assert [name for name, same in report["self_test"].items() if not same] == ["knee", "chain"]
    assert report["machine_code"]["platform"]
    assert report["plugins"]


def test_a_run_that_fails_is_a_difference(monkeypatch):
    limits = {"limits": {"max_steps": 3}}
    monkeypatch.setattr(self_test, "RUNS", {"pendulum": ("pendulum", limits)})
    assert self_test.compared() == {"pendulum": False}
