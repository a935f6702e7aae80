"""The packaged designs: run by name, their optima and their reports."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from tests.designs.design_command import command

from mbdkit.spec import example_names
from mbdkit_design.design_loading import load_design_spec

UPPER, FOREARM = "model.forces.upper spring.stiffness", "model.forces.forearm spring.points.0.1"


@pytest.fixture(scope="module")
def balance(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("designs") / "balance"
    done = command("design", "gravity-balance", "-o", str(folder), "--report", "--quiet")
    assert done.exit_code == 0, done.stderr
    return folder


def test_stiffness_and_attachment_of_the_balanced_arm_are_found(balance: Path) -> None:
    # expected: k h b = m g c; links have their centres at half of 0.4 m, springs end at b = 0.1 m along the links
    gravity, along = 9.81, 0.1
    upper = gravity * (1.2 * 0.2 + 0.3 * 0.2 + (0.2 + 1.5) * 0.4) / (along * 0.1)
    height = gravity * 1.5 * 0.2 / (along * 294.3)
    found = json.loads((balance / "design.json").read_text("utf-8"))
    assert found["best"]["variables"][UPPER] == pytest.approx(upper, rel=1e-8)
    assert found["best"]["variables"][FOREARM] == pytest.approx(height, rel=1e-8)
    assert found["trust"]["is_gain"]["goal"]
    assert found["trust"]["verdict"] not in ("bad", "doubtful", "failed")


def test_the_report_has_device_loads_variables_trust_and_surroundings(balance: Path) -> None:
    page = (balance / "report.html").read_text("utf-8")
    for heading in ("device-start", "device-best", "figure-load-1-1", "table-variables", "table-goals", "claim-runs"):
        assert f'id="{heading}"' in page
    assert page.count('id="figure-cut-') == 2
    rows = re.findall(r"<th scope=\"row\"[^>]*>stiffness of upper spring</th>(.*?)</tr>", page, flags=re.DOTALL)
    assert [float(value) for value in re.findall(r'data-value="(.*?)"', rows[0])] == pytest.approx(
        [500, 700, 961.38, 1500]
    )


def test_every_packaged_design_is_valid_and_listed_and_others_are_named() -> None:
    listed = command("examples").stdout
    for name in example_names("design"):
        assert load_design_spec(name).title in listed
    assert "did you mean 'gravity-balance'?" in command("design", "gravity-balanse").stderr
    assert "which `mbdkit design` solves" in command("run", "gravity-balance").stderr
    assert "this study is valid" not in command("validate", "exotendon").stdout
