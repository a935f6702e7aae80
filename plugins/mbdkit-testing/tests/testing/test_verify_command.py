"""`mbdkit plugins verify` at the command line."""

from __future__ import annotations

import json
from typing import Any

import pytest


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


@pytest.mark.end_to_end
def test_as_html_it_is_a_page_that_is_not_replaced_unasked(
    mbdkit: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert mbdkit("plugins", "verify", "mbdkit:linear", "--html").exit_code == 0
    page = tmp_path / "mbdkit-linear-verification.html"
    assert "derivatives.rate" in page.read_text(encoding="utf-8")
    again = mbdkit("plugins", "verify", "mbdkit:linear", "--html")
    assert again.exit_code == 2
    assert "this file exists" in again.stderr
    assert mbdkit("plugins", "verify", "mbdkit:linear", "--html", "--overwrite", "-q").exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["gaus"], "there is no plugin 'gaus' (did you mean 'gauss'?)"),
        (["gauss", "--set", "stages=9"], "stages: should be at most 6, not 9"),
        (["gauss", "--set", "stagse=2"], "stagse: unknown key (did you mean 'stages'?)"),
        (["gauss", "--set", "stages"], "should have the form KEY=VALUE"),
        (["mechanism"], "mbdkit:mechanism needs options: bodies: a mechanism needs at least one body or beam; give"),
        (["n-pendulum"], "'n', the number of rods, is missing"),
        (["linear", "-o", "page.pdf"], "its name must end in .html or .htm"),
        (["linear", "-o", "nowhere/page.html"], "the folder nowhere does not exist"),
    ],
)
def test_wrong_input_is_one_sentence_and_exit_status_2(mbdkit: Any, arguments: list[str], expected: str) -> None:
    result = mbdkit("plugins", "verify", *arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert expected in result.stderr
    assert len(result.stderr.splitlines()) == 1
