"""Designs against optima in closed form: regression of moments, balanced springs, active limits and Pareto fronts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.designs.swinging_shank import BRACE, ONE, T, design_of, mean, moments, shank, swing
from typer.testing import CliRunner

import mbdkit
from mbdkit.base.errors import RunError
from mbdkit.cli import app
from mbdkit.plugin.specs import write_yaml
from mbdkit_design.design_loading import load_design_spec
from tests.identified import MASS, sliding, write_fit


@pytest.mark.parametrize(("optimizer", "starts"), [("slsqp", 2), ("trust-constr", 1)])
def test_the_best_torsion_spring_is_the_regression_of_the_moment(optimizer: str, starts: int) -> None:
    # expected: torque of the motor = moment - k (phi_0 - phi), with k and k phi_0 by least squares
    angle, moment = moments()
    matrix = [[mean(angle**2), -mean(angle)], [-mean(angle), 1.0]]
    k, k_free = np.linalg.solve(matrix, [-mean(angle * moment), mean(moment)])
    found = mbdkit.design(design_of(swing(), optimizer={"name": optimizer, "tolerance": 1e-9, "starts": starts}))
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(k, rel=1e-4)
    assert found.best.variables[f"{BRACE}.free_angle"] == pytest.approx(k_free / k, rel=3e-4)
    assert found.best.goals["goal"] == pytest.approx(mean((moment - k_free + k * angle) ** 2), abs=1e-6)
    assert found.trust.is_gain["goal"]


def test_a_design_of_inverse_dynamics_without_known_noise_has_no_estimate_of_its_error() -> None:
    # expected: <(k phi - 2)^2> of the brace is least at k = 2 <phi> / <phi^2>, but for the rule on rows
    m = shank()
    data = {"time": T.tolist(), "angle": (0.2 + 0.5 * np.sin(3 * T)).tolist()}
    motion = {"data": data, "columns": {"knee.angle": "angle"}, "smooth": "quintic"}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion}
    found = mbdkit.design(design_of(spec, variables=ONE, minimize="mean((-forces.brace.value - 2)**2)"))
    angle, _ = moments()
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(2 * mean(angle) / mean(angle**2), rel=1e-3)
    assert np.isnan(found.trust.errors["goal"])
    assert found.trust.is_gain["goal"] is None
    assert found.to_dict()["trust"]["is_gain"]["goal"] is None
    assert "may be due to errors of the runs, which were not estimated" in found.summary()


@pytest.mark.slow
def test_scenarios_are_summed_by_their_weights() -> None:
    # expected: with phi_0 = 0, the sum of w_s <(M_s + k phi_s)^2> is least at k = -sum w_s <M phi> / sum w_s <phi^2>
    amplitudes, weights = (0.5, 1.2), (1.0, 0.3)
    over = under = 0.0
    for amplitude, weight in zip(amplitudes, weights, strict=True):
        angle, moment = moments(amplitude)
        over, under = over - weight * mean(moment * angle), under + weight * mean(angle**2)
    specs = [swing(amplitude) for amplitude in amplitudes]
    scenarios = {name: {"base": spec, "weight": w} for name, spec, w in zip("ab", specs, weights, strict=True)}
    found = mbdkit.design(design_of(None, scenarios=scenarios, variables=ONE))
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(over / under, rel=1e-6)
    total = sum(w * found.best.measures[name]["goal"] for name, w in zip("ab", weights, strict=True))
    assert found.best.goals["goal"] == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize(
    "optimizer",
    ["slsqp", *(pytest.param(name, marks=pytest.mark.slow) for name in ("trust-constr", "differential-evolution"))],
)
def test_a_limit_that_is_active_holds_at_the_best_point(optimizer: str) -> None:
    # expected: the brace may exert 3 N m at most, at the largest angle
    spec, most = swing(), 0.7  # the angle is 0.2 + 0.5 sin(3 t)
    limits = {"torque": {"value": "max(abs(forces.brace.value))", "max": 3.0}}
    options: dict[str, Any] = {"name": optimizer, "tolerance": 1e-4 if "evolution" in optimizer else 1e-9}
    if optimizer == "differential-evolution":
        options |= {"population": 8, "max_iterations": 60}
    found = mbdkit.design(design_of(spec, variables=ONE, subject_to=limits, optimizer=options))
    rel = 1e-5 if optimizer == "slsqp" else 1e-2
    assert found.is_feasible
    assert found.best.variables[f"{BRACE}.stiffness"] == pytest.approx(3.0 / most, rel=rel)
    assert found.best.measures[""]["torque"] <= 3.0 * (1 + 1e-6)
    first = found.start.measures[""]["torque"]
    assert first == pytest.approx(most * found.start.variables[f"{BRACE}.stiffness"])
    wrong = f"but the start is not allowed: torque is {first:.4g} N m, {first - 3:.4g} N m above its limit of 3"
    assert wrong in found.summary()


@pytest.mark.slow
def test_two_goals_give_a_front_between_their_least_values() -> None:
    # expected: <(M + k phi)^2> falls, and the torque of the brace rises, from k = 0 to the regression
    spec = swing()
    angle, moment = moments()
    k = -mean(moment * angle) / mean(angle**2)
    goals = {"moment": "mean(joints.motor.torque**2)", "brace": "rms(forces.brace.value)"}
    found = mbdkit.design(design_of(spec, variables=ONE, minimize=goals, front=5))
    stiffness = np.array([point.variables[f"{BRACE}.stiffness"] for point in found.front])
    brace = np.array([point.goals["brace"] for point in found.front])
    np.testing.assert_allclose(stiffness, np.linspace(k, 0.0, 5), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(brace, stiffness * np.sqrt(mean(angle**2)), rtol=1e-6, atol=1e-6)
    assert found.best in found.front


def pendulum(step: float = 0.05, **variables: Any) -> dict[str, Any]:
    base = {"time": {"end": 1.0, "step": step}, "integrator": {"name": "gauss", "stages": 1}}
    spec = {"mbdkit": 1, "model": {"name": "single-pendulum", "angle": 0.0}, **base}
    return {"mbdkit_design": 1, "base": spec, "variables": variables, "minimize": "final(rod1.y)"}


def test_errors_of_a_design_are_those_of_its_measures_in_the_runs() -> None:
    given = pendulum(0.1, **{"model.length": {"bounds": [0.9, 1.1]}})
    found = mbdkit.design(given)
    at_best = {"name": "single-pendulum", "angle": 0.0, "length": found.best.variables["model.length"]}
    run = mbdkit.run(given["base"] | {"model": at_best, "check": True, "measures": {"y": "final(rod1.y)"}})
    assert found.best.goals["goal"] == run.measures["y"]
    assert found.trust.errors["goal"] == run.measure_errors["y"] > 1e-4


def test_a_gain_within_the_error_of_the_method_counts_as_none() -> None:
    # a length that may change by 1e-6 m changes y by about as much; steps of 0.1 s have errors of 1e-3 m and more
    given = pendulum(0.1, **{"model.length": {"bounds": [1.0, 1.000001], "start": 1.0000005}})
    found = mbdkit.design(given)
    assert found.trust.errors["goal"] > 1e-4
    assert not found.trust.is_gain["goal"]
    assert "does not count as a gain" in found.summary()


def test_a_best_point_at_a_bound_is_told() -> None:
    given = pendulum(**{"model.angle": {"bounds": [-1.0, 0.5]}})
    assert "model.angle is at its upper bound." in mbdkit.design(given | {"minimize": "-final(rod1.y)"}).summary()


def test_several_starts_leave_a_local_minimum() -> None:
    # the angle at the start is free: y after 1 s has several minima, and the one from the only start is not the least
    angle = {"model.angle": {"bounds": [-1.5, 9.0], "start": 4.5}}
    alone = mbdkit.design(pendulum(**angle))
    several = mbdkit.design(pendulum(**angle) | {"optimizer": {"name": "slsqp", "starts": 3}})
    assert several.best.goals["goal"] <= alone.best.goals["goal"] + 1e-12
    assert several.searches[1] == 3


def test_a_run_that_fails_at_the_start_is_an_error() -> None:
    given = pendulum(**{"model.angle": {"bounds": [0.0, 1.0]}})
    given["base"]["limits"] = {"max_steps": 3}
    with pytest.raises(RunError, match="a run fails at the start of the variables: max-steps"):
        mbdkit.design(given)


def test_the_command_writes_a_folder_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = pendulum(**{"model.angle": {"bounds": [-1.0, 0.5]}})
    Path("drop.json").write_text(json.dumps(given), encoding="utf-8")
    done = CliRunner().invoke(app, ["design", "drop.json", "--json"], prog_name="mbdkit")
    assert done.exit_code == 0, done.stderr
    printed, stored = json.loads(done.stdout), json.loads(Path("drop/design.json").read_text(encoding="utf-8"))
    assert printed.pop("robustness")
    assert printed.pop("warnings") == mbdkit.load_design("drop").warnings
    assert stored.pop("sha256")
    assert {"mbdkit_result": 1, **printed} == {"path": "drop", **stored}
    best = stored["best"]["variables"]["model.angle"]
    with mbdkit.load("drop/best.h5") as run:
        assert run.spec["model"]["angle"] == best
        assert run.measures["goal"] == pytest.approx(stored["best"]["goals"]["goal"], rel=1e-12)


@pytest.mark.slow
def test_limits_that_cannot_be_met_are_told_by_the_exit_status(tmp_path: Path) -> None:
    given = pendulum(**{"model.angle": {"bounds": [0.0, 0.1]}})
    given["subject_to"] = {"height": {"value": "final(rod1.y)", "min": 10.0}}
    base = given.pop("base")
    given["scenarios"] = {"plain": {"base": base}, "spare": {"base": base | {"parameters": {"T": 1.0}}}}
    file = tmp_path / "high.json"
    file.write_text(json.dumps(given), encoding="utf-8")
    told = "warning: scenario spare: the parameter at parameters.T is not used"
    assert told in CliRunner().invoke(app, ["validate", str(file)], prog_name="mbdkit").stderr
    done = CliRunner().invoke(app, ["design", str(file), "-o", str(tmp_path / "high")], prog_name="mbdkit")
    assert done.exit_code == 3
    assert "No point that satisfies all limits was found" in done.stdout
    assert "violates them least: height in plain is" in done.stdout
    assert " below its limit of 10" in done.stdout
    assert told in done.stdout


@pytest.mark.parametrize("is_inline", [False, True])
def test_the_base_of_a_design_takes_estimated_parameters(tmp_path: Path, *, is_inline: bool) -> None:
    write_fit(tmp_path)
    (tmp_path / "base.yaml").write_text(write_yaml(sliding()), "utf-8")
    design = {
        "mbdkit_design": 1, "base": sliding() if is_inline else "base.yaml", "minimize": "-final(block.x)",
        "variables": {"stiffness": {"bounds": [1, 50]}},
    }  # fmt: skip
    (tmp_path / "design.yaml").write_text(write_yaml(design), "utf-8")
    spec = load_design_spec(tmp_path / "design.yaml").specs[""]
    assert spec.parameters["mass"] == MASS
    assert spec.estimated is not None
    assert spec.estimated.names == ("mass",)  # the stiffness is chosen
