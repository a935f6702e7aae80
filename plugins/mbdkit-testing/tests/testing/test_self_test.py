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
    assert "8 of 10 runs have the same bits" in outcome.output
    assert "self-test: knee, chain: last bits differ" in outcome.output


def test_json_says_which_runs_agree(mbdkit, other_bits):
    report = json.loads(mbdkit("doctor", "--json").stdout)
    assert [name for name, text in report["self_test"].items() if text != "equal"] == ["knee", "chain"]
    assert report["machine_code"]["platform"]
    assert report["plugins"]


def test_runs_that_fail_are_reported_with_the_rest(mbdkit, monkeypatch):
    limits, damaged = {"limits": {"max_steps": 3}}, {"model": {"name": "no-such-model"}}
    monkeypatch.setattr(self_test, "RUNS", {"short": ("pendulum", limits), "unknown": ("pendulum", damaged)})
    outcome = mbdkit("doctor")
    assert outcome.exit_code == 1
    assert "machine code for" in outcome.output
    assert "self-test: 'short' failed: max-steps" in outcome.output
    assert "self-test: 'unknown' failed: " in outcome.output
