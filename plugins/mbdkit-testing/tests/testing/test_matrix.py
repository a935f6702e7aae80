"""The matrix of plugins: recorded figures side by side, and what does not hold any more."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mbdkit.cli import app
from mbdkit.registry.manager import registry
from mbdkit_testing import matrix
from mbdkit_testing.check_result import Report, failed, passed
from mbdkit_testing.recorded_evidence import record_of, write_records


def drawn(*arguments: str, status: int = 0) -> str:
    done = CliRunner().invoke(app, ["plugins", "matrix", *arguments], prog_name="mbdkit")
    assert done.exit_code == status, done.output
    return done.output


def test_the_matrix_has_a_row_for_all_options_that_were_verified_and_links_to_their_figures(tmp_path: Path) -> None:
    drawn("-o", str(tmp_path / "m"))
    rows = list(csv.DictReader((tmp_path / "m" / "matrix.csv").read_text(encoding="utf-8").splitlines()))
    methods = {item.id for item in registry().of_kind("integrator")}
    assert methods == {row["id"] for row in rows if row["kind"] == "integrator"}
    orders = {row["options"]: row["order: driven pendulum"] for row in rows if row["id"] == "mbdkit:gauss"}
    for stages in (1, 2, 3, 4):  # Gauss collocation with s stages has the order 2 s
        assert float(orders[f"stages {stages}"]) == pytest.approx(2 * stages, abs=0.2)
    page = (tmp_path / "m" / "matrix.html").read_text(encoding="utf-8")
    places = re.findall(r'id="([^"]+)"', page)
    assert len(places) == len({*places})
    assert set(re.findall(r'href="#([^"]+)"', page)) <= {*places}
    assert len(json.loads((tmp_path / "m" / "matrix.json").read_text(encoding="utf-8"))["rows"]) == len(rows)
    assert "exists already" in drawn("-o", str(tmp_path / "m"), status=2)


def report(outcome: str, **figures: float) -> Report:
    result = (
        failed("it claims order 4, but the observed one is 3.00", **figures) if outcome == "fail" else passed(**figures)
    )
    results = (replace(result, name="order.four-bar"), replace(passed(), name="geometry.energy"))
    return Report("mbdkit:rk4", "integrator", "1.0", {}, {"order": 4}, results)


@pytest.mark.parametrize("outcome", ["pass", "fail"])
def test_a_claim_that_held_and_does_not_hold_now_is_named(
    outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    item, old = registry().get("integrator", "rk4"), tmp_path / "old.json"
    write_records([record_of(item, report("pass", measured=4.01), quick=True)], old)
    asked: list[Any] = []
    monkeypatch.setattr(matrix, "verify", lambda *a, **k: asked.append((a, k)) or report(outcome, measured=3.0))
    told = drawn("-o", str(tmp_path / "m"), "--against", str(old), status=int(outcome == "fail"))
    assert asked == [(("integrator", "mbdkit:rk4", {}), {"quick": True})]
    sentence = "mbdkit:rk4: order.four-bar: pass before, now: it claims order 4, but the observed one is 3.00"
    assert (sentence in told) == (outcome == "fail")
    page = (tmp_path / "m" / "matrix.html").read_text(encoding="utf-8")
    assert ("broken: 1" in page) == ("fail: four-bar" in page) == (outcome == "fail")


def test_evidence_about_what_is_not_installed_is_refused_by_name(tmp_path: Path) -> None:
    item, old = registry().get("integrator", "rk4"), tmp_path / "old.json"
    record = record_of(item, report("pass"), quick=True)
    write_records([record | {"distribution": "acme", "name": "leapfrog"}], old)
    assert "acme:leapfrog" in drawn("-o", str(tmp_path / "m"), "--against", str(old), status=2)
    assert "no evidence" in drawn("-o", str(tmp_path / "m"), "--against", str(Path(__file__)), status=2)
    deep = tmp_path / "deep.json"
    deep.write_text("[" * 100_000)
    assert "it is nested too deeply" in drawn("-o", str(tmp_path / "m"), "--against", str(deep), status=2)
    assert not (tmp_path / "m").exists()
