"""The packaged designs: run by name, their optima and their reports; designs of inverse dynamics with muscles."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.designs.design_command import command

import mbdkit
from mbdkit.spec import example_names
from mbdkit_biomech.inverse_dynamics.results import measure_samples
from mbdkit_design.derivatives import derivatives, differences
from mbdkit_design.design_loading import load_design_spec
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.trust import certified

UPPER, FOREARM = "model.forces.upper spring.stiffness", "model.forces.forearm spring.points.0.1"


@pytest.fixture(scope="module")
def balance(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("designs") / "balance"
    done = command("design", "gravity-balance", "-o", str(folder), "--report", "--quiet")
    assert done.exit_code == 0, done.stderr
    return folder


@pytest.mark.slow
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
    for heading in ("glance", "device-start", "figure-load-1-1", "table-variables", "table-goals", "claim-runs"):
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


ROWS, DEVIATION, LEVER = 50, 4.0, 0.3


def pushed_rod() -> dict:
    """Return a rod at rest that a vertical force with noise pushes at a lever, and a spring at its hinge."""
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(LEVER, 0.0))
    m.revolute("hip", m.ground, rod, at=(0, 0))
    m.torsion_spring("spring", m.ground, rod, stiffness=10.0, free_angle=0.5)
    time, zero, push = np.linspace(0, 1, ROWS).tolist(), [0.0] * ROWS, [30.0] * ROWS
    columns = {"hip.angle": {"column": "a", "deviation": 1e-9}}
    force = [0.0, {"column": "push", "deviation": DEVIATION}]
    loads = {"push": {"body": "rod", "force": force, "data": {"time": time, "push": push}}}
    motion = {"data": {"time": time, "a": zero}, "columns": columns, "smooth": {"name": "butterworth", "cutoff": 5}}
    return {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": loads}


def test_noise_cancels_in_the_gain_of_a_spring_and_leaves_what_the_spring_changes(monkeypatch):
    # expected: the mean of N independent values has the deviation of one over sqrt(N), which is the same at both
    # points; with the torque u + e of noisy loads, mean((u + e)^2) - mean((u + e - s)^2) has the error 2 s mean(e).
    # Bounds of 16 samples scatter by 18 %.
    monkeypatch.setattr(measure_samples, "SAMPLES", 16)
    variables = {"model.forces.spring.stiffness": {"bounds": [5, 15], "start": 10.0}}
    goals = {"mean": "mean(actuators.hip.value)", "square": "mean(actuators.hip.value**2)"}
    design = {"mbdkit_design": 1, "base": pushed_rod(), "variables": variables, "minimize": goals}
    trust = certified(Evaluator(load_design_spec(design)), np.array([0.5]), np.array([0.9]))
    bound = 1.96 * LEVER * DEVIATION / np.sqrt(ROWS)
    assert abs(trust.gain["mean"]) == pytest.approx(4.0 * 0.5, rel=1e-9)
    assert trust.errors["mean"] == pytest.approx(bound, rel=0.5)
    assert trust.gain_errors["mean"] < 1e-6
    assert trust.gain_errors["square"] == pytest.approx(2 * (4.0 * 0.5) * bound, rel=0.5)


def test_goals_and_limits_of_the_packaged_design_have_exact_derivatives():
    evaluator = Evaluator(load_design_spec("knee-spring-muscles"))
    x = evaluator.point({"model.forces.knee spring.stiffness": 20.0, "model.forces.knee spring.free_angle": 0.1})
    found = derivatives(evaluator, x)
    assert not evaluator.why_differences
    places = [
        evaluator.names.index(name) for name in ("knee", "hip")
    ]  # frames at their peaks, whose muscles stay active
    np.testing.assert_allclose(found[:, places], differences(evaluator, x)[:, places], rtol=1e-6)
