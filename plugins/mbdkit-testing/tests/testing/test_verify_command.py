"""The commands `mbdkit plugins verify` and `where`, the self-test, and the pages that this part generates."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import mbdkit
import mbdkit.plugin
from mbdkit.base.errors import SpecError
from mbdkit.guide.pages import find_page
from mbdkit.registry.manager import registry
from mbdkit_testing import item_places, self_test

from . import spec_page


def test_what_is_verified_leaves_with_0_and_says_so(mbdkit: Any) -> None:
    result = mbdkit("plugins", "verify", "linear", "--set", "stiffness=20", "--set", "damping=1")
    assert result.exit_code == 0
    assert "mbdkit:linear" in result.stdout
    assert "verified: 9 checks run" in result.stdout


def test_what_is_not_verified_leaves_with_1(mbdkit: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mbdkit_testing.force_law_checks.AGREE", -1.0)  # nothing agrees better than that
    result = mbdkit("plugins", "verify", "linear", "--set", "stiffness=20")
    assert result.exit_code == 1
    assert "not verified: " in result.stdout
    assert "derivatives.length" in result.stdout


def test_as_json_it_is_one_object_on_stdout(mbdkit: Any) -> None:
    told = json.loads(mbdkit("plugins", "verify", "double-pendulum", "--json").stdout)
    (report,) = told["reports"]
    assert (report["id"], report["kind"], report["verified"]) == ("mbdkit:double-pendulum", "model", True)
    assert {"name", "what", "outcome", "cause", "figures", "seconds", "limits"} == set(report["checks"][0])


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["gaus"], "there is no plugin 'gaus' (did you mean 'gauss'?)"),
        (["gauss", "--set", "stages=9"], "stages: should be at most 6, not 9"),
        (["gauss", "--set", "stagse=2"], "stagse: unknown key (did you mean 'stages'?)"),
        (["gauss", "--set", "stages"], "should have the form KEY=VALUE"),
        (["mechanism"], "mbdkit:mechanism needs options: bodies: a mechanism needs at least one body or beam; give"),
        (["n-pendulum"], "'n', the number of rods, is missing"),
        (["linear", "-o", "evidence.json"], "-o takes effect only with --record"),
    ],
)
def test_wrong_input_is_one_sentence_and_exit_status_2(mbdkit: Any, arguments: list[str], expected: str) -> None:
    result = mbdkit("plugins", "verify", *arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert expected in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "field", "file", "begins"),
    [
        ("gauss", "create", "mbdkit/methods/gauss.py", "def create("),
        ("gauss", "options", "mbdkit/methods/gauss.py", "class GaussOptions("),
        ("single-pendulum", "build", "mbdkit/models/pendulums.py", "def build_single("),
        ("table", "law", "mbdkit/laws/tabulated.py", "LAW = "),
        ("modes", "target", "plugins/mbdkit-statics/src/mbdkit_statics/commands.py", "def modes("),
        ("plugins new", "target", "plugins/mbdkit-testing/src/mbdkit_testing/commands.py", "def plugins_new("),
        ("drift", "spec", "plugins/mbdkit-paper/src/mbdkit_paper/drift/study.yaml", ""),
    ],
)
def test_where_prints_the_line_that_defines_what_a_name_adds(name, field, file, begins):
    found = item_places.whereabouts(name)
    (place,) = (place for item in found["items"] for place in item["places"] if place["field"] == field)
    path = Path(place["file"])
    assert path == Path(mbdkit.__file__).parents[1] / file
    assert path.read_text(encoding="utf-8").splitlines()[place["line"] - 1].startswith(begins)
    assert f"{path}:{place['line']}" in item_places.whereabouts_text(found)


def test_where_suggests_a_name():
    with pytest.raises(SpecError, match="there is no item 'gaus' \\(did you mean 'gauss'"):
        item_places.whereabouts("gaus")


def test_the_reference_of_specs_is_fresh() -> None:
    fresh = spec_page.page(registry().only("mbdkit"))
    command = "python plugins/mbdkit-testing/tests/testing/spec_page.py mbdkit/guide/spec.md"
    assert find_page("spec").text == fresh, f"stale: {command}"


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
    monkeypatch.setattr(self_test, "RUNS", {"pendulum": limits, "knee": damaged})
    outcome = mbdkit("doctor")
    assert outcome.exit_code == 1
    assert "machine code for" in outcome.output
    assert "self-test: 'pendulum' failed: max-steps" in outcome.output
    assert "self-test: 'knee' failed: " in outcome.output
