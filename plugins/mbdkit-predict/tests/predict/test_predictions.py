"""Predictions against exact optima, and what is refused."""

from __future__ import annotations

import copy
import ctypes
import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar
from typer.testing import CliRunner

import mbdkit
from mbdkit import MbdkitError, SpecError
from mbdkit.cli import app
from mbdkit.plugin.specs import write_yaml
from mbdkit_predict import nonlinear_program, transcription
from mbdkit_predict.nonlinear_program import _Watcher
from mbdkit_predict.predict_loading import compared_spec, load_predict_spec
from mbdkit_predict.predicted_run import transcribed
from mbdkit_predict.processes import Stop
from mbdkit_predict.transcription import OF_POINTS, Mesh
from predict import chains
from predict.chains import chain
from predict.exact_optima import AT_REST, BLOCK, DRAG, EFFORT, EXACT, PUSH, block, of_states, swing_up
from tests.identified import MASS, STIFFNESS, sliding, write_fit
from tests.margins import assert_within


@pytest.mark.slow
@pytest.mark.parametrize("name", EXACT)
def test_the_error_bar_of_exact_optima_covers_and_is_sharp(name: str) -> None:
    spec, exact = EXACT[name]
    run = mbdkit.predict(spec)
    assert (run.status, run.verdict) == ("complete", "good")
    assert run.kind == "predicted"
    error = abs(run.objective - exact)
    assert error <= run.objective_error <= max(10.0 * error, 1.0001e-8 * exact)
    assert run.mesh[-1][1] == run.objective
    if spec["minimize"] == "final(t)":
        assert run.time[-1] == pytest.approx(run.objective)
    if "gauss" not in name:  # on few intervals, powers are integrated with less accuracy
        assert_within(run.energy.balance, 1e-4)


def test_the_swing_up_of_a_cart_pole_has_its_optimum() -> None:
    run = mbdkit.predict("cart-pole")
    error = abs(run.objective - swing_up(5, 80))
    assert error <= run.objective_error <= max(10.0 * error, 1.0001e-8 * run.objective)
    assert run["pole"].angle[-1] == pytest.approx(np.pi / 2, abs=1e-8)
    assert_within(run.joints["pin"].misalignment, 1e-8)


@pytest.mark.slow
def test_starts_find_the_local_optima_of_a_swing_up() -> None:
    run = mbdkit.predict("cart-pole", starts=5, tolerance=1e-2)
    assert_within(run.objective - 57.944781, run.objective_error)
    assert run.objective_error < 0.6
    assert "starts        of 5, " in run.summary()
    assert sum(abs(value - 58.8077) < 0.01 for value in run.starts) >= 1  # the optimum of the first guess


@pytest.mark.slow
def test_gauss_methods_have_their_order_on_nonlinear_joints() -> None:
    # on meshes of equal intervals, errors of order 4 fall by 16; without projection, no motion is found
    exact, spec = (
        swing_up(5, 80, -10.0),
        load_predict_spec("cart-pole", (), coordinates="absolute", collocation={"method": "gauss", "points": 2}),
    )
    method = transcribed(spec)
    mesh = method.solved(method.guess(), Stop())
    errors = []
    for _ in range(2):
        finer = mesh.grid.divided(np.full(len(mesh.grid.phase), 2))
        values = {name: np.repeat(mesh.values[name], 2, axis=1) for name in OF_POINTS}
        mesh = method.solved(Mesh(finer, method._with_nodes(dict(mesh.values) | values)), Stop())
        assert mesh.solution is not None
        errors.append(abs(mesh.solution.objective - exact))
    assert 14.0 < errors[0] / errors[1] < 20.0
    assert errors[0] < 0.02


LOADS = {"near": "whole*share", "far": "(1 - share)*whole"}  #: Two loads whose sum is the parameter `whole`.


def spring(stiffness: float) -> dict[str, Any]:
    points = [[0.5, 0.0], [0, 0]]
    return {
        "spring": {"type": "spring-damper", "bodies": ["ground", "block"], "points": points, "stiffness": stiffness}
    }


def test_a_parameter_is_optimized_together_with_the_motion() -> None:
    # a spring k about x = 1/2: with omega = pi (half a period from rest at 0 to rest at 1), no force is needed
    run = mbdkit.predict(block(forces=spring(3.0), parameters={"forces.spring.stiffness": {"bounds": [0.0, 50.0]}}))
    assert run.status == "complete"
    assert run.parameters["forces.spring.stiffness"] == pytest.approx(np.pi**2, rel=1e-4)
    assert run.objective < 1e-8
    assert run.mechanism.forces["spring"].stiffness == run.parameters["forces.spring.stiffness"]


def test_controls_that_are_not_determined_are_named() -> None:
    second = {"second": {"type": "force", "body": "block", "value": [0.0, 0.0]}}
    goal = f'integral((controls["{PUSH}"] + controls["forces.second.value[0]"])**2)'
    both = {name: {"bounds": [-100, 100]} for name in (PUSH, "forces.second.value[0]")}
    run = mbdkit.predict(block(forces=second, controls=both, minimize=goal))
    assert_within(run.objective - 12.0, run.objective_error)
    words = f"Controls are not determined: `{PUSH}` and `forces.second.value[0]` may change in the ratio 1:-1"
    assert run.verdict == "good"
    assert any(reason.startswith(words) for reason in run.verdict_reasons)


def test_a_motion_that_is_not_determined_is_doubtful() -> None:
    # the second block ends at a place at any speed, and its force costs nothing
    model = copy.deepcopy(BLOCK)
    model["bodies"]["other"] = model["bodies"]["block"]
    model["joints"]["other"] = model["joints"]["rail"] | {"bodies": ["ground", "other"]}
    model["forces"]["other"] = {"type": "force", "body": "other", "value": [0.0, 0.0]}
    spec = block(controls={name: {"bounds": [-50, 50]} for name in (PUSH, "forces.other.value[0]")})
    spec["initial"] = AT_REST | {"other.x": 0, "other.vx": 0}
    run = mbdkit.predict(spec | {"base": {"model": model}, "final": spec["final"] | {"other.x": 1}})
    assert_within(run.objective - 12.0, run.objective_error)
    assert run.verdict == "doubtful"
    assert "`forces.other.value[0]` may change without a change of the objective" in run.verdict_reasons[0]


def test_an_archive_of_a_prediction_is_read_and_repeated(tmp_path: Path) -> None:
    path = tmp_path / "block.h5"
    done = CliRunner().invoke(app, ["predict", "block", "-o", str(path), "--report"], prog_name="mbdkit")
    assert done.exit_code == 0, done.output
    page = (tmp_path / "block-report.html").read_text()
    assert "by direct collocation with the stages of Radau IIA methods" in page
    assert "No stabilization is used" not in page
    assert "objective     12 +- 1.2e-07 on 40 intervals" in done.stdout
    with mbdkit.load(path) as run:
        t, force = run.time, run.controls[PUSH].value
        np.testing.assert_allclose(force, 6.0 - 12.0 * t, atol=1e-6)
        np.testing.assert_allclose(run["block"].position[:, 0], t**2 * (3.0 - 2.0 * t), atol=1e-9)
        np.testing.assert_allclose(run.forces["push"].value, np.abs(force), atol=1e-12)
        assert run.kind == "predicted"
    done = CliRunner().invoke(app, ["rerun", str(path), "-o", str(tmp_path / "again.h5")], prog_name="mbdkit")
    assert done.exit_code == 0, done.output
    with pytest.raises(mbdkit.RunError, match="it is no prediction"):
        _ = mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}).objective


def test_a_motion_that_cannot_be_is_infeasible(tmp_path: Path) -> None:
    run = mbdkit.predict(block(controls={PUSH: {"bounds": [-1, 1]}}, duration=0.5))
    assert (run.status, run.status_reason.split(":")[0]) == ("failed", "infeasible")
    assert "`final: block.x` cannot hold with the others: the nearest motion misses it by 0.938" in run.status_reason
    assert np.isnan(run.objective_error)
    assert len(run.time) == 61
    assert (run.verdict, "no optimum" in run.verdict_reasons[0]) == ("bad", True)
    assert "at the best iterate, which is no optimum" in run.summary()
    run = mbdkit.predict(block(final={"2*block.x": 1, "3*block.x": 4}))
    assert "`final: 2*block.x` cannot hold with the others" in run.status_reason


@pytest.mark.parametrize(
    ("changed", "key", "text"),
    [
        ({"minimize": "max(block.x)"}, "minimize", "'max' is not smooth"),
        ({"minimize": "block.x"}, "minimize", ""),
        ({"minimize": "integral(controls.push)"}, "minimize", "no control 'push'"),
        ({"initial": {"block.ax": 0}}, "initial", "not known at the start"),
        ({"final": {"blok.x": 0}}, "final", "did you mean 'block'"),
        ({"subject_to": {"a": {"value": "block.z", "max": 1}}}, "subject_to.a.value", "block.z"),
        ({"controls": {PUSH: {"bounds": [1, -1]}}}, 'controls."forces.push.value[0]".bounds', "is above"),
        ({"controls": {"forces.pull.value": {"bounds": [0, 1]}}}, "model.forces.pull.value", "no 'pull' here"),
        ({"collocation": {"points": 4}}, "collocation.points", "radau has 2, 3, 5 or 7 points, not 4"),
        ({"base": "blok"}, "base", "`mbdkit examples` lists all"),
        ({"durration": 1.0}, "durration", "(did you mean 'duration'?); known here: base, overrides, title"),
        ({"phases": [{"duration": 1.0}]}, "duration", "each of the `phases` has its own"),
        ({"duration": None}, "duration", "is missing"),
        ({"compare": {"gravity": 0}}, "compare", "only parameters and model are compared"),
        ({"controls": {}}, "controls", "at least one control"),
        ({"controls": {PUSH: {"bounds": [-1, 1], "start": 2}}}, f'controls."{PUSH}".start', "within the bounds"),
        ({"duration": {"bounds": [1, 2], "start": 3}}, "duration.start", "within the bounds"),
        ({"subject_to": {"a": {"value": "block.x"}}}, "subject_to.a", "no effect without `min` or `max`"),
        ({"subject_to": {"a": {"value": "block.x", "min": 2, "max": 1}}}, "subject_to.a", "is above"),
        ({"overrides": {"integrator": "x"}}, "overrides", "only parameters and model of the base"),
        ({"parameters": {PUSH: {"bounds": [0, 1]}}}, f"model.{PUSH}", "is a control"),
        ({"parameters": {"bodies.block.mass": {"bounds": [-1, 2]}}}, "model.bodies.block.mass", "the bound -1 of this"),
        ({"controls": {"forces.push.value": {"bounds": [0, 1]}}}, "model.forces.push.value", "has components"),
        ({"compare": {f"model.{PUSH}": 1}}, "compare", "because it is a control"),
        ({"final": {"block.x": [2, 1]}}, 'final."block.x"', "the lower bound 2 is above the upper bound 1"),
        ({"minimize": "integral(controls['forces.push.value[0]']"}, "minimize", "is written controls['forces.push"),
    ],
)  # fmt: skip
def test_a_wrong_spec_is_one_sentence(changed: dict[str, Any], key: str, text: str) -> None:
    with pytest.raises(SpecError) as caught:
        mbdkit.predict(block(**changed))
    assert caught.value.key == key
    assert text in caught.value.message


def test_peaks_are_minimized() -> None:
    force = f'controls["{PUSH}"]'
    run = mbdkit.predict(block(minimize=f"peak(abs({force}))"))  # bang-bang
    assert_within(run.objective - 4.0, run.objective_error)
    assert run.objective_error < 1e-6

    # a force P for a time 1 - h, and then a linear one: the effort is P^2 (4/(3 h) - 1)
    def total(h: float) -> float:
        peak = 1.0 / (0.5 - h / 3.0)
        return peak**2 * (4.0 / (3.0 * h) - 1.0) + 2.0 * peak

    exact = float(minimize_scalar(total, (0.3, 0.7, 1.0), options={"xtol": 1e-12}).fun)
    run = mbdkit.predict(block(minimize=f"{EFFORT} + 2*peak({force})"))
    assert run.verdict == "good"
    assert_within(run.objective - exact, run.objective_error)
    assert run.objective_error < 1e-5
    with pytest.raises(SpecError, match=r"'max' is not smooth, .* use integral, mean, rms, final or peak"):
        mbdkit.predict(block(minimize=f"max({force})"))


def test_the_rate_of_a_control_is_minimized() -> None:
    # least jerk from rest to rest: x = 10 t^3 - 15 t^4 + 6 t^5
    spec = block(
        controls={"states.force.rate": {"bounds": "none"}}, minimize='integral(controls["states.force.rate"]**2)',
        final={"block.x": 1, "block.vx": 0, "states.force.value": 0},
    )  # fmt: skip
    spec["base"]["model"] |= {"states": {"force": {"initial": 0, "rate": "0", "unit": "N"}}}
    spec["base"]["model"]["forces"]["push"]["value"] = ["states.force.value", 0]
    run = mbdkit.predict(spec)
    assert run.verdict == "good"
    assert_within(run.objective - 720.0, run.objective_error)
    assert run.objective_error < 1e-4


@pytest.mark.slow
def test_the_peak_force_of_a_joint_is_less_where_it_is_minimized() -> None:
    effort = load_predict_spec("assisted-squat").minimize
    runs = [mbdkit.predict("assisted-squat", compare={}, minimize=f"{effort} + {w}*peak(abs(joints.knee.force))")
            for w in (0, 1e-4)]  # fmt: skip
    peaks = [float(np.hypot(*run.joints["knee"].reaction_force.T).max()) for run in runs]
    assert peaks[1] < 0.8 * peaks[0]
    found = (runs[1].objective - runs[0].objective) / 1e-4
    # the effort grows, so that the derivative of the optimum by the weight falls from one peak to the other
    assert peaks[1] < found < peaks[0]


@pytest.mark.slow
def test_a_first_mesh_above_the_limit_is_refined_once() -> None:
    run = mbdkit.predict(block(collocation={"points": 2, "intervals": 400}))
    assert run.status == "complete"
    assert [count for count, _ in run.mesh] == [400, 800]
    assert_within(run.objective - 12.0, run.objective_error)


def test_examples_are_valid_and_without_casadi_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("block", "cart-pole", "assisted-sit-to-stand", "elastic-jump"):
        assert load_predict_spec(name).title
        done = CliRunner().invoke(app, ["validate", name], prog_name="mbdkit")
        assert "controls     forces." in done.stdout
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MbdkitError, match=r"predictions need the package casadi: install it with `pip install"):
        mbdkit.predict("block")


def test_a_run_with_the_controls_of_a_closed_loop_is_the_predicted_motion() -> None:
    # expected: the motion of the engine, by another method and in its own steps
    m = mbdkit.Mechanism()
    m.body("crank", mass=1.0, inertia=0.02, position=(0.0, 0.25), angle=np.pi / 2)
    m.body("coupler", mass=2.0, inertia=0.2, position=(0.5, 0.6), angle=0.2)
    m.body("rocker", mass=1.5, inertia=0.1, position=(1.0, 0.35), angle=np.pi / 2)
    m.revolute("A", m.ground, "crank", points=((0, 0), (-0.25, 0)))
    m.revolute("B", "crank", "coupler", points=((0.25, 0), (-0.51, 0)))
    m.revolute("C", "coupler", "rocker", points=((0.51, 0), (0.35, 0)))
    m.revolute("D", m.ground, "rocker", points=((1.0, 0), (-0.35, 0)))
    m.torque("motor", "crank", value=0.0)
    q0 = m.to_casadi().q0
    run = mbdkit.predict(
        {
            "mbdkit_predict": 1, "base": {"model": m.to_spec()}, "duration": 1.0,
            "controls": {"forces.motor.value": {"bounds": [-200, 200]}},
            "initial": {"crank.angle": float(q0[2]), "crank.angular_velocity": 0},
            "final": {"crank.angle": float(q0[2]) - 1.0, "crank.angular_velocity": 0},
            "minimize": "integral(forces.motor.value**2)", "tolerance": 1e-6,
        }
    )  # fmt: skip
    assert run.status == "complete"
    assert_within([run.joints[name].misalignment for name in "ABCD"], 1e-9)
    table = {"table": [run.time.tolist(), run.controls["forces.motor.value"].value.tolist()]}
    m.forces.clear()
    m.torque("motor", "crank", value=table)
    forward = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.001}).check()
    np.testing.assert_allclose(forward["rocker"].angle[-1], run["rocker"].angle[-1], atol=1e-5)
    np.testing.assert_allclose(forward["rocker"].angular_velocity[-1], 0.0, atol=1e-4)
    np.testing.assert_allclose(np.interp(0.4, forward.time, forward.joints["C"].reaction_force[:, 0]),
                               np.interp(0.4, run.time, run.joints["C"].reaction_force[:, 0]), rtol=1e-3)  # fmt: skip


def test_phases_are_joined_by_a_spline() -> None:
    # expected: the least integral of x''^2 through a point is that of the clamped cubic spline
    run = mbdkit.predict(
        block(duration=None, phases=[{"duration": 0.4, "final": {"block.x": 0.75}}, {"duration": 0.6, "intervals": 30}])
    )
    spline = CubicSpline([0.0, 0.4, 1.0], [0.0, 0.75, 1.0], bc_type="clamped").derivative(2)
    exact = sum(h * (a * a + a * b + b * b) / 3.0 for h, a, b in ((0.4, *spline([0, 0.4])), (0.6, *spline([0.4, 1]))))
    assert_within(run.objective - exact, run.objective_error)
    assert run.objective_error <= 1e-7 * exact
    assert run.mesh[0] == ((20, 30), pytest.approx(exact))
    assert np.interp(0.4, run.time, run["block"].position[:, 0]) == pytest.approx(0.75)


def test_a_path_condition_of_a_phase_with_a_free_duration_holds_in_it_only() -> None:
    # |F| <= 1 and, for the first metre, v <= 1: 1 s + 0.5 s; then 2 m with a peak v = sqrt(2.5): 2 v - 1
    free, slow = {"bounds": [0.1, 10]}, {"slow": {"value": "block.vx", "max": 1}}
    run = mbdkit.predict(
        block(
            duration=None, controls={PUSH: {"bounds": [-1, 1]}}, final={"block.x": 3, "block.vx": 0}, tolerance=1e-5,
            collocation={"intervals": 10},
            phases=[{"duration": free, "subject_to": slow, "final": {"block.x": 1}}, {"duration": free}],
            minimize="final(t)",
        )
    )  # fmt: skip
    assert_within(run.objective - (0.5 + 10.0**0.5), run.objective_error)
    assert run.objective_error < 4e-5


def test_half_a_step_mirrors_left_and_right() -> None:
    # each of two blocks takes the place and the velocity of the other: 2 x 12, from rest to rest, although velocities
    # are free: with s their mean, 12 ((1 - s)^2 + (1 + s)^2) + 2 (v(1) - v(0))^2
    spec = block(initial={"block.x": 0}, final={}, periodic=[{"block.x": "other.x"}, {"block.vx": "other.vx"}])
    model = spec["base"]["model"]
    model["bodies"]["other"] = {"mass": 1.0, "inertia": 1.0, "position": [1, 0]}
    model["joints"]["guide"] = model["joints"]["rail"] | {"bodies": ["ground", "other"]}
    model["forces"]["pull"] = {"type": "force", "body": "other", "value": [0.0, 0.0]}
    controls = {PUSH: {"bounds": [-100, 100]}, "forces.pull.value[0]": {"bounds": [-100, 100]}}
    both = "integral(forces.push.value**2 + forces.pull.value**2)"
    run = mbdkit.predict(spec, controls=controls, initial={"block.x": 0, "other.x": 1}, minimize=both)
    assert_within(run.objective - 24.0, run.objective_error)
    assert run["block"].velocity[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_sensitivities_are_differences_of_optima() -> None:
    # 12 x^2 / T^3; the spring by differences of optima
    def of_spring(stiffness: float) -> mbdkit.Run:
        return mbdkit.predict(block(forces=spring(stiffness)), sensitivities=["forces.spring.stiffness"])

    rates = of_spring(3.0).sensitivities
    both = [of_spring(3.0 + step).objective for step in (-0.01, 0.01)]
    assert rates["forces.spring.stiffness"] == pytest.approx((both[1] - both[0]) / 0.02, rel=1e-4)
    rates = mbdkit.predict("block").sensitivities
    assert rates["duration"] == pytest.approx(-36.0, rel=1e-6)
    assert rates["final: block.x"] == pytest.approx(24.0, rel=1e-6)


def test_a_named_parameter_is_optimized_wherever_it_occurs() -> None:
    # 12 m^2: a mass of which half is that of a second block that is welded to the first one
    spec = block()
    model = spec["base"]["model"]
    half = {"mass": "0.5*m", "inertia": 1.0}
    model["bodies"] = {"block": half, "load": half}
    model["joints"] |= {"weld": {"type": "weld", "bodies": ["block", "load"], "at": [0.0, 0.0], "angle": 0.0}}
    spec["base"]["parameters"] = {"m": "2*n", "n": 0.5}
    run = mbdkit.predict(spec, sensitivities=["m"])
    assert run.sensitivities["m"] == pytest.approx(24.0, rel=1e-6)
    run = mbdkit.predict(spec, parameters={"n": {"bounds": [0.25, 2.0]}})
    assert (run.objective, run.parameters["n"]) == pytest.approx((3.0, 0.25), rel=1e-6)
    spec["base"]["parameters"]["w"] = 1.0
    with pytest.raises(SpecError, match=r"minimize: depends on 'm', which therefore can neither be optimized"):
        mbdkit.predict(spec, minimize=f"m*{EFFORT}", sensitivities=["m"])
    with pytest.raises(SpecError, match=r"subject_to: depends on 'n', which therefore can neither be optimized"):
        mbdkit.predict(spec, subject_to={"slow": {"value": "block.vx*m", "max": 9}}, sensitivities=["n"])
    with pytest.raises(SpecError, match=r"parameters\.w: .* the equations of motion do not contain it"):
        mbdkit.predict(spec, parameters={"w": {"bounds": [0.5, 2.0]}})
    with pytest.raises(SpecError, match=r"parameters\.nn: there is no parameter 'nn'.*'n'"):
        mbdkit.predict(spec, parameters={"nn": {"bounds": [0.25, 2.0]}})


@pytest.mark.parametrize("name", ["push", "whole"])
def test_a_named_parameter_is_a_control_wherever_it_occurs(name: str) -> None:
    # 12 for the whole force, which is that of two loads of a parameter each, or of one parameter of another
    spec = block()
    model = spec["base"]["model"]
    loads = {key: {"type": "force", "body": "block", "value": [value, 0.0]} for key, value in LOADS.items()}
    model["forces"] = loads
    spec["base"]["parameters"] = {"push": 2.0, "share": 0.25, "whole": "push/share", "length": 1.0}
    spec |= {"controls": {name: {"bounds": [-100, 100]}}, "minimize": "integral(whole**2)"}
    run = mbdkit.predict(spec)
    scale = {"push": 0.25, "whole": 1.0}[name]
    assert run.objective == pytest.approx(12.0, rel=1e-8)
    np.testing.assert_allclose(run.controls[name].value, scale * (6.0 - 12.0 * run.time), atol=1e-6)
    other = mbdkit.predict(spec, minimize=f"integral(controls.{name}**2)")
    assert other.objective == pytest.approx(12.0 * scale**2, rel=1e-8)
    other = mbdkit.predict(spec, sensitivities=["share"], minimize=f"integral(controls.{name}**2)")
    assert other.sensitivities["share"] == pytest.approx({"push": 24.0 * 0.25, "whole": 0.0}[name], abs=1e-5)
    model["bodies"]["block"]["mass"] = "length"
    with pytest.raises(SpecError, match=r"model\.bodies\.block\.mass: is no control, because it cannot change"):
        mbdkit.predict(spec, controls={"length": {"bounds": [0, 1]}}, minimize="integral(length)")
    with pytest.raises(SpecError, match=r"controls\.lenght: the model uses no parameter 'lenght'.*'length'"):
        mbdkit.predict(spec, controls={"lenght": {"bounds": [0, 1]}})
    model["bodies"]["block"]["mass"], model["states"] = 1.0, {name: {"initial": 0.0, "rate": "1"}}
    with pytest.raises(SpecError, match=rf"controls\.{name}: has the name of a state"):
        mbdkit.predict(spec)
    del model["states"]
    with pytest.raises(SpecError, match=rf"parameters\.{name}: is a control, so that it is no parameter"):
        mbdkit.predict(spec, sensitivities=[name], minimize=f"integral(controls.{name}**2)")


def test_conditions_contain_named_parameters() -> None:
    # 12 v^2 for a way of v t in one second
    spec = block()
    spec["base"]["parameters"] = {"v": 2.0, "most": 20.0}
    wanted = {
        "final": {"block.x - v*t": 0, "block.vx": 0},
        "subject_to": {"slow": {"value": "block.vx - most", "max": 0}},
    }
    assert mbdkit.predict(spec, **wanted).objective == pytest.approx(48.0, rel=1e-6)
    run = mbdkit.predict(spec, **wanted, guess={"final": {"block.x - 0.5*v*t": 0}})
    assert run["block"].position[-1, 0] == pytest.approx(2.0)


def test_the_gain_of_a_spring_has_an_error() -> None:
    minimize = f"{EFFORT} - 100*final(t)"  # 0 - 100 instead of 12 - 100
    run = mbdkit.predict(
        block(
            forces=spring(3.0), parameters={"forces.spring.stiffness": {"bounds": [0.0, 50.0]}},
            compare={"model.forces.spring.stiffness": 0.0}, minimize=minimize,
        )
    )  # fmt: skip
    assert_within(run.gain().value - 12.0, run.gain().error)
    assert run.gain().error < 1e-5
    assert run.gain(mbdkit.predict(block(minimize=minimize))).value == pytest.approx(12.0)
    assert "gain          12 +- " in run.summary()
    assert ", 13.64 % of the motion that is compared" in run.summary()  # 12 of 88


def test_an_element_whose_name_begins_that_of_a_control_can_be_compared() -> None:
    own = spring(3.0)["spring"]
    spec = block(forces={"pus": own}, compare={"model.forces.pus": own | {"stiffness": 0.0}})
    assert compared_spec(load_predict_spec(spec)).mechanism().forces["pus"].stiffness == 0.0


@pytest.mark.parametrize("w", [3.0, 3.3])
def test_a_search_that_begins_at_a_saddle_leaves_it(w: float) -> None:
    # x = 0 is stationary for the integral of x'^2 - w^2 x^2, x = 0 at both ends, and a minimum if w < pi (Jacobi);
    # else, with |x'| <= 10, x' = 10 up to the time s, then x'' = -w^2 x, symmetric about the middle; x' is continuous
    spec = of_states({"x": {"rate": "states.turn"}, "turn": {"rate": "0"}}, {"x": 0}, [-10.0, 10.0])
    spec["controls"]["states.turn"]["start"] = 0.0
    square = f'integral(controls["states.turn"]**2 - {w**2}*states.x.value**2)'
    run = mbdkit.predict(spec, duration=1.0, minimize=square)
    s = 0.0 if w < np.pi else brentq(lambda s: w * s * np.tan(w * (0.5 - s)) - 1.0, 0.1, 0.3)
    assert (run.status, run.verdict) == ("complete", "good")
    assert_within(run.objective + 200.0 * w**2 * s**3 / 3.0, run.objective_error + 1e-9)


@pytest.mark.parametrize(
    ("bounds", "minimize", "optimum"),
    [
        ([-3.0, 3.0], f"-{EFFORT}", -9.0),
        ([-3.0, 3.0], "-final(block.x)**2", -2.25),
        ("none", f"-{EFFORT}", None),  # unbounded
        ([-3.0, 3.0], EFFORT, 0.0),
        ("none", EFFORT, 0.0),
    ],
)
def test_a_search_that_begins_at_a_stationary_point_ends_at_a_minimum(
    bounds: Any, minimize: str, optimum: float | None
) -> None:
    run = mbdkit.predict(block(controls={PUSH: {"bounds": bounds}}, minimize=minimize, final={}))
    if optimum is None:
        assert (run.status, run.verdict, run.status_reason.partition(":")[0]) == ("failed", "bad", "unbounded")
    else:
        assert (run.status, run.verdict) == ("complete", "good")
        assert run.objective == pytest.approx(optimum, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_stationary_motion_without_curvature_is_doubtful(speed: float) -> None:
    # many controls lead to x = 0; at rest, the search ends at its guess without a step
    control, initial = {PUSH: {"bounds": "none"}}, {"block.x": 0, "block.vx": speed}
    run = mbdkit.predict(block(controls=control, initial=initial, minimize="final(block.x)**2", final={}))
    assert (run.status, run.verdict) == ("complete", "doubtful")
    assert_within(run.objective, 1e-9)
    assert "second-order" in run.verdict_reasons[0]


def test_a_stationary_point_whose_curvature_is_not_examined_is_no_minimum_on_finer_meshes_either() -> None:
    # 20 iterations are too few for the search from the guess nearby
    spec = load_predict_spec(block(controls={PUSH: {"bounds": [-3, 3]}}, minimize=f"-{EFFORT}", final={}))
    method = transcribed(spec)
    mesh = method.solved(method.guess(), Stop(), 20)
    for _ in range(2):
        solution = mesh.solution
        assert solution is not None
        assert (solution.is_optimum, solution.objective, solution.is_strict) == (True, 0.0, False)
        mesh = method.solved(method.refined(mesh), Stop())


@pytest.mark.parametrize(("sign", "optimum"), [(1.0, 0.0), (-1.0, -4.0)])
def test_a_free_start_leaves_a_stationary_point(sign: float, optimum: float) -> None:
    free = {"block.x": 0, "block.vx": [-2.0, 2.0]}
    still = {PUSH: {"bounds": [0.0, 0.0]}}
    run = mbdkit.predict(block(controls=still, minimize=f"{sign}*final(block.x)**2", initial=free, final={}))
    assert (run.status, run.verdict) == ("complete", "good")
    assert run.objective == pytest.approx(optimum, abs=1e-6)


def test_opposed_controls_leave_a_stationary_point() -> None:
    # the sum of two forces is zero, and the integral of the square of their difference is largest
    pull = {"pull": {"type": "force", "body": "block", "value": [0.0, 0.0]}}
    other = PUSH.replace("push", "pull")
    run = mbdkit.predict(
        block(
            forces=pull, controls={name: {"bounds": [-3, 3]} for name in (PUSH, other)}, final={},
            subject_to={"still": {"value": "block.vx", "min": 0, "max": 0}},
            minimize=f'-integral((controls["{PUSH}"] - controls["{other}"])**2)',
        )
    )  # fmt: skip
    assert (run.status, run.verdict) == ("complete", "good")
    assert run.objective == pytest.approx(-36.0, rel=1e-6)


def test_a_forward_run_tells_an_unstable_motion() -> None:
    push = {"away": {"type": "force", "body": "block", "value": ["900*block.x", 0]}}
    run = mbdkit.predict(block(forces=push, duration=2.0, controls={PUSH: {"bounds": [-5000, 5000]}}))
    assert run.forward_run["of_intervals"] < 1e-6 < 1e-3 < run.forward_run["largest"]
    assert (run.verdict, "The motion is unstable" in run.verdict_reasons[0]) == ("doubtful", True)


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"minimize": "-final(t)", "duration": {"bounds": [0.5, 1e30]}}, "unbounded"),
        ({"final": {"block.x": 1, "2*block.x": 1}}, "infeasible"),
        ({"minimize": "integral(sqrt(block.x - 5))"}, "not-solved"),
    ],
)  # fmt: skip
def test_what_has_no_optimum_is_told_in_one_sentence(changed: dict[str, Any], code: str) -> None:
    run = mbdkit.predict(block(**changed))
    assert (run.status, run.status_reason.split(":")[0]) == ("failed", code)
    assert "\n" not in run.status_reason


@pytest.mark.slow
def test_muscles_with_elastic_tendons_move_a_forearm_as_in_a_run_with_their_excitations() -> None:
    # expected: the motion of the engine with explicit rates of the fibres, by another method and in its own steps
    names = ("biceps", "brachialis", "triceps")
    run = mbdkit.predict(
        {
            "mbdkit_predict": 1, "base": "elbow-curl", "duration": 0.8, "collocation": {"intervals": 8},
            "controls": {f"muscles.{name}.excitation": {"bounds": [0.01, 1], "start": 0.1} for name in names},
            "tolerance": 1e-2,
            "initial": {"forearm.angle": -1.396, "forearm.angular_velocity": 0},
            "final": {"forearm.angle": 0.3, "forearm.angular_velocity": 0},
            "minimize": "integral(" + "+".join(f"muscles.{name}.activation**2" for name in names) + ")",
        }
    )  # fmt: skip
    assert run.status == "complete"
    assert run.forward_run["end"] < 1e-3
    assert 0.1 < np.abs(run.muscles["biceps"].fiber_rate[1:]).max() / (10 * 0.132) < 1.0


@pytest.mark.slow
def test_finer_meshes_of_a_squat_with_active_limits_confirm_its_spring() -> None:
    run = mbdkit.predict("assisted-squat")
    assert (run.status, run.verdict) == ("complete", "good")
    assert run.gain().value > 1e4 * run.gain().error
    # `final` and `subject_to` both hold the knee straight: its multiplier is finite, since only one of them is asked
    assert abs(run.sensitivities["final: knee.angle"]) < 1.0


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    "minimize",
    [
        "integral(forces.push.value**2) + final(t)**2 + final(block.vx)**2",
        "mean(forces.push.value**2)*(2 + final(block.vx)) + mean(block.vx**2) - integral(block.x**3)*final(t)",
    ],
)
def test_derivatives_of_points_and_ends_are_those_of_the_whole_program(
    minimize: str, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transcription, "WORTH_THREADS", 0)
    phases = [
        {"duration": {"bounds": [0.1, 1.0]}, "subject_to": {"slow": {"value": "block.vx**2", "max": 3}}},
        {"duration": {"bounds": [0.2, 1.0]}, "intervals": 3, "final": {"block.x**3": 1}},
    ]
    spec = block(
        phases=phases, forces=DRAG | spring(3.0), parameters={"forces.spring.stiffness": {"bounds": [0, 10]}},
        minimize=minimize, collocation={"points": 2, "intervals": 2},
    )  # fmt: skip
    problem = transcribed(load_predict_spec({k: x for k, x in spec.items() if k not in ("duration", "final")}))
    unknowns, _, conditions, objective, jacobian, hessian = problem._program(problem.guess().grid, threads)
    x, factor = ca.vertcat(*map(ca.vec, unknowns.values())), ca.MX.sym("factor")
    values = ca.vertcat(*(ca.vec(condition.value) for condition in conditions))
    lam, random = ca.MX.sym("lam", values.numel()), np.random.default_rng(0)
    whole = ca.Function(
        "whole", [x, factor, lam], [ca.triu(ca.hessian(factor * objective + ca.dot(lam, values), x)[0])]
    )
    sizes = random.uniform(0.5, 2.0, x.numel())
    parts = hessian.whole({condition.name: condition.value for condition in conditions}, x, sizes)
    at, multipliers = random.standard_normal(x.numel()), random.standard_normal(values.numel())
    slopes = ca.Function("slopes", [x], [values, ca.jacobian(values, x)])(sizes * at)
    found = jacobian.whole(x, sizes)(at, [])
    np.testing.assert_array_equal(np.array(found[0]), np.array(slopes[0]))
    np.testing.assert_allclose(np.array(ca.DM(found[1])), np.array(ca.DM(slopes[1])) * sizes, rtol=1e-13, atol=1e-13)
    expected = np.diag(sizes) @ np.array(ca.DM(whole(sizes * at, 1.7, multipliers))) @ np.diag(sizes)
    np.testing.assert_allclose(
        np.array(ca.DM(parts(at, [], 1.7, multipliers))), expected, atol=1e-13 * abs(expected).max()
    )


def test_the_linear_solver_uses_one_thread_while_it_works(monkeypatch: pytest.MonkeyPatch) -> None:
    files = [file for file in Path(ca.__file__).parent.glob("*openblas*") if file.suffix in (".0", ".dll")]
    assert files or sys.platform != "linux"
    blas, counts, eval_of = [ctypes.CDLL(str(file)) for file in files], set[int](), _Watcher.eval

    def counted(watcher: _Watcher, values: Any) -> list[int]:
        counts.update(library.openblas_get_num_threads() for library in blas)
        return eval_of(watcher, values)

    monkeypatch.setattr(_Watcher, "eval", counted)
    before = [library.openblas_get_num_threads() for library in blas]
    problem = transcribed(load_predict_spec("block"))
    assert problem.solved(problem.guess(), Stop(), 100).solution.is_optimum  # in this process
    assert counts == {1} if blas else not counts
    assert [library.openblas_get_num_threads() for library in blas] == before


@pytest.mark.parametrize("is_inline", [False, True])
def test_the_base_of_a_prediction_takes_estimated_parameters(tmp_path: Path, *, is_inline: bool) -> None:
    write_fit(tmp_path)
    base = sliding()
    base["model"]["forces"]["push"] = {"type": "force", "body": "block", "value": [0.0, 0.0]}
    (tmp_path / "base.yaml").write_text(write_yaml(base), "utf-8")
    path = tmp_path / "predict.yaml"
    sections = {"controls": {PUSH: {"bounds": [0, 2]}}, "duration": 1.0, "minimize": EFFORT}
    path.write_text(write_yaml({"mbdkit_predict": 1, "base": base if is_inline else "base.yaml", **sections}), "utf-8")
    spec = load_predict_spec(path)
    assert spec.parameters == {"stiffness": STIFFNESS, "mass": MASS}
    assert spec.estimated is not None
    assert [file.name for file in spec.files_read] == ["fit.h5"]


@pytest.mark.parametrize("coordinates", ["joint", "absolute"])
def test_a_mechanism_without_freedom_moves_only_its_states(coordinates: str) -> None:
    # least effort of a state that its control moves by 1 in 1 s
    weld = {"type": "weld", "bodies": ["ground", "block"], "points": [[0, 0], [0, 0]]}
    states = {"x": {"rate": "states.u"}, "u": {"rate": "0"}}
    spec = block(coordinates=coordinates, initial={}, final={})
    spec["base"]["model"]["joints"] = {"rail": weld}
    with pytest.raises(mbdkit.SpecError, match=r"model\.joints: the mechanism has no degree of freedom, and neither"):
        mbdkit.predict(spec)
    spec["base"]["model"]["states"] = states
    spec |= {"controls": {"states.u": {"bounds": [-5, 5]}}, "minimize": "integral(states.u**2)"}
    run = mbdkit.predict(spec | {"final": {"states.x.value": 1}})
    assert abs(run.objective - 1.0) <= run.objective_error


def test_a_search_whose_meshes_wander_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    # optima on meshes of 5 and 10 intervals are 88.5 and 128.6; that of the transcription in absolute angles is 436.94
    monkeypatch.setattr(chains, "ANGLE", 0.6)
    program, start = chains.program(4, 40, 5)
    exact = float(ca.nlpsol("angles", "ipopt", program, nonlinear_program._OPTIONS)(**start)["f"])
    run = mbdkit.predict(chain(4, angle=0.6) | {"collocation": {"intervals": 5}, "tolerance": 1e-4})
    assert run.objective == pytest.approx(exact, rel=1e-4)
    assert run.verdict_reasons[-1] == "Local minimum: 2 of 2 starts end here."
    table = run.summary()
    assert "the start wanders" in table
    assert "10 x 7, " in table


@pytest.mark.slow
def test_an_optimum_that_no_second_guess_finds_after_wandering_is_doubtful() -> None:
    run = mbdkit.predict(chain(5, angle=0.6) | {"collocation": {"intervals": 8}, "tolerance": 1e-4})
    assert run.verdict == "doubtful"
    assert run.verdict_reasons[0].endswith("Local minimum: 1 of 2 starts end here.")  # the other one is an artefact


def test_a_number_and_the_parameter_that_gives_it_are_not_asked_for_together() -> None:
    spec = block(sensitivities=["m", "bodies.block.mass"])
    spec["base"]["model"]["bodies"]["block"]["mass"] = "m"
    spec["base"]["parameters"] = {"m": 2.0}
    with pytest.raises(mbdkit.SpecError, match="depends on the parameter 'm'") as error:
        mbdkit.predict(spec)
    assert error.value.key == "model.bodies.block.mass"
    for name in spec["sensitivities"]:  # least effort of 12 m^2
        assert mbdkit.predict(spec | {"sensitivities": [name]}).sensitivities[name] == pytest.approx(48.0)
