"""First guesses from archives, and from simpler problems."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbdkit
from mbdkit import SpecError
from mbdkit.cli import app
from mbdkit.spec.loading import example_text
from mbdkit_predict.predict_loading import load_predict_spec
from mbdkit_predict.predicted_run import transcribed
from mbdkit_predict.transcription import Transcription
from predict.exact_optima import PUSH, block
from predict.measured_walking import predicted
from tests.margins import assert_within


def problem_of(spec: dict[str, Any], archive: Path, coordinates: str = "absolute") -> Transcription:
    return transcribed(load_predict_spec(spec | {"guess": str(archive), "coordinates": coordinates}))


@pytest.mark.parametrize(
    ("coordinates", "share"), [pytest.param("absolute", 0.5, marks=pytest.mark.slow), ("joint", 0.9)]
)
def test_a_warm_start_reaches_the_same_optimum_in_fewer_iterations(
    tmp_path: Path, coordinates: str, share: float
) -> None:
    path = tmp_path / "first.h5"
    cold = mbdkit.predict("cart-pole", tolerance=1e-2, coordinates=coordinates, archive=path)
    warm = mbdkit.predict("cart-pole", tolerance=1e-2, coordinates=coordinates, guess=path)
    assert warm.stats["newton_iterations"] < share * cold.stats["newton_iterations"]
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)


def test_phases_of_an_archive_are_stretched(tmp_path: Path) -> None:
    # the least 12 / T^3 + 36 T is at T = 1 s, with x = 3 t^2 - 2 t^3; the first phase, 0.25 s, becomes 0.5 s
    last = {"duration": {"bounds": [0.1, 1.5]}, "final": {"block.x": 1, "block.vx": 0}}
    spec = block(duration=None, final={}, phases=[{"duration": 0.25}, last])
    mbdkit.predict(spec, archive=tmp_path / "block.h5", minimize="integral(forces.push.value**2 + 36)")
    spec["base"]["model"]["bodies"]["other"] = {"mass": 1.0, "position": [3, 0]}
    guess = problem_of(spec | {"phases": [{"duration": 0.5}, last]}, tmp_path / "block.h5").guess()
    s, pace = np.where(guess.times < 0.5, guess.times / 2, guess.times - 0.25), np.where(guess.times < 0.5, 0.5, 1.0)
    np.testing.assert_allclose(guess.values["duration"], [0.5, 0.75], rtol=1e-6)
    for name, exact in (("q", 3 * s**2 - 2 * s**3), ("v", pace * 6 * (s - s**2)), ("a", pace**2 * (6 - 12 * s))):
        np.testing.assert_allclose(guess.values[name][0], exact, atol=1e-3, err_msg=name)
    np.testing.assert_allclose(guess.values["u"][0], 6 - 12 * s, atol=1e-3)
    np.testing.assert_array_equal(guess.values["q"][3], 3.0)


def test_an_inverse_analysis_is_a_guess(tmp_path: Path) -> None:
    m = mbdkit.Mechanism()
    rod = m.body("rod", mass=1.0, inertia=0.1, position=(0.0, -0.5))
    m.revolute("hip", m.ground, rod, at=(0, 0))
    t = np.linspace(0.0, 2.0, 401)
    motion = {"data": {"time": t, "hip": 0.5 * np.sin(3 * t)}, "columns": {"hip.angle": "hip"}}
    mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion}, archive=tmp_path / "rod.h5")
    m.torque("hip", rod, value=0.0)
    spec: dict[str, Any] = {
        "mbdkit_predict": 1, "base": {"model": m.to_spec()}, "duration": {"bounds": [0.5, 9]},
        "controls": {"forces.hip.value": {"bounds": [-9, 9]}}, "minimize": "integral(forces.hip.value**2)",
    }  # fmt: skip
    problem = problem_of(spec, tmp_path / "rod.h5")
    guess = problem.guess()
    of_joint = problem_of(spec, tmp_path / "rod.h5", "joint").guess()
    for name in "qva":  # the angle of the rod is the coordinate of the joint
        np.testing.assert_array_equal(of_joint.values[name][0], guess.values[name][2])
    assert guess.values["duration"] == pytest.approx(2.0)
    angle = 0.5 * np.sin(3 * guess.times)
    expected = {
        "q": (2, angle), "v": (2, 1.5 * np.cos(3 * guess.times)), "a": (2, -9.0 * angle),
        "u": (0, -0.35 * 9.0 * angle + 0.5 * 9.81 * np.sin(angle)),
    }  # fmt: skip
    for name, (row, exact) in expected.items():
        np.testing.assert_allclose(guess.values[name][row], exact, atol=2e-3 * abs(exact).max(), err_msg=name)
    values = [guess.values[name] for name in ("q", "v", "a", "lam", "z", "u")]
    balance = np.array(problem.system.residual(*values, [], guess.times[None]))
    assert_within(balance, 0.01)  # N, with reactions of up to 15 N


def test_the_optimum_of_a_simpler_problem_is_a_guess() -> None:
    # the least integral of the squared force is that of 6 - 12 t, in half the time with twice the velocity
    spec = block(controls={PUSH: {"bounds": [0, 100]}, "states.brake": {"bounds": [-100, 0]}}, final={"block.x": 1})
    model = spec["base"]["model"]
    model["states"] = {"brake": {"rate": 0}}
    model["forces"]["brake"] = {"type": "force", "body": "block", "value": ["states.brake", 0]}
    simpler = {"controls": {PUSH: {"bounds": [-100, 100]}}, "duration": 0.5, "final": {"block.x": 1, "block.vx": 0}}
    guess = transcribed(load_predict_spec(spec | {"guess": simpler})).guess()
    t = guess.times
    np.testing.assert_allclose(guess.values["q"][0], 3 * t**2 - 2 * t**3, atol=1e-3)
    np.testing.assert_allclose(guess.values["v"][0], 6 * (t - t**2), atol=1e-3)
    np.testing.assert_allclose(guess.values["u"], [24 - 48 * t, 0 * t], atol=1e-6)
    wrongs = {"starts": 3}, {"controls": {"forces.no.value": {}}}, {"minimize": "integral(nonsense.x)"}
    for wrong, key in zip(wrongs, ("guess.starts", "guess.controls", "guess.minimize"), strict=True):
        with pytest.raises(SpecError) as caught:
            transcribed(load_predict_spec(spec | {"guess": wrong}))
        assert caught.value.key.startswith(key)


@pytest.mark.slow  # half a minute, and three minutes
@pytest.mark.parametrize("name", ["half-step", "predicted-walking"])
def test_ground_reactions_carry_the_walker(name: str) -> None:
    run = mbdkit.predict(name)
    assert run.verdict == "good", run.verdict_reasons
    # half a period of a periodic motion: no change of momentum
    mechanism, contacts = run.mechanism, ("heel", "ball", "heel_left", "ball_left")
    weight = 9.81 * sum(body.mass for body in mechanism.bodies.values())
    force = sum(run.contacts[name].normal_force for name in contacts)
    assert np.trapezoid(force, run.time) / run.time[-1] == pytest.approx(weight, rel=0.01)
    push = sum(run.contacts[name].friction_force for name in contacts)
    assert abs(np.trapezoid(push, run.time)) < 0.01 * np.trapezoid(abs(push), run.time)
    assert run["trunk"].position[-1, 0] == pytest.approx(1.25 * run.time[-1])
    if name == "predicted-walking":  # R. Browning et al. (2007): the mean of persons without a load; the page `walking`
        frequency, share, curves = predicted(run)
        assert frequency == pytest.approx(0.268, rel=0.03)
        assert np.trapezoid(curves["up"], share) == pytest.approx(0.5, rel=0.02)  # each foot carries half of the weight
    np.testing.assert_allclose(run["thigh"].angle[-1], run["thigh_left"].angle[0], atol=1e-9)
    activation = run.muscles["soleus"].activation
    np.testing.assert_allclose(activation[-1], run.muscles["soleus_left"].activation[0], atol=1e-9)


def test_a_wrong_archive_is_one_sentence(tmp_path: Path) -> None:
    mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}).save(tmp_path / "pendulum.h5")
    for name, text in (("no.h5", "there is no such archive"), ("pendulum.h5", "it has rod1; the mechanism has block")):
        with pytest.raises(SpecError, match=text) as caught:
            problem_of(block(), tmp_path / name)
        assert caught.value.key == "guess"


def test_an_archive_is_repeated_with_the_same_guess_only(tmp_path: Path) -> None:
    def command(*words: str) -> Any:
        return CliRunner().invoke(app, list(words), prog_name="mbdkit")

    first, second = tmp_path / "first.h5", str(tmp_path / "second.h5")
    mbdkit.predict("block", archive=first)
    (tmp_path / "block.yaml").write_text(example_text("block") + "guess: first.h5\n")
    assert command("predict", str(tmp_path / "block.yaml"), "-o", second).exit_code == 0
    assert "only with --files" in command("rerun", second).stderr
    assert command("rerun", second, "--files").exit_code == 0
    never = command("predict", str(tmp_path / "block.yaml"), "-o", str(first), "--overwrite")
    assert (never.exit_code, "input" in never.stderr) == (2, True), never.stderr
    mbdkit.predict("block", tolerance=1e-2, archive=first, overwrite=True)
    assert "its SHA-256 differs" in command("rerun", second, "--files").stderr
