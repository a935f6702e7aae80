"""The patella against published curves of knees from 0 to 120 degrees, and the forces that it leaves in a knee."""

import numpy as np
import pytest

import mbdkit
from mbdkit import SpecError
from mbdkit.base.errors import PluginError
from mbdkit.engine.compile_forces import Lowering
from mbdkit.mechanism.quantity_names import QuantityNames
from mbdkit.plugin.specs import read_source
from mbdkit_biomech.muscles.muscle_path import MusclePath
from mbdkit_biomech.muscles.patella import ANGLE, FLEXION, SHARE, contact_share, lever_arm

FLEXIONS = np.radians(np.arange(0.0, 121.0, 5.0))


def leg(**muscle):
    """Return a thigh on the ground and a shank whose weight flexes the knee, with a muscle of the quadriceps."""
    m = mbdkit.Mechanism()
    shank = m.body("shank", mass=3.5, inertia=0.05, position=(0.0, -0.19))
    m.revolute("knee", m.ground, shank, at=(0.0, 0.0))
    data = {**m.to_spec(), "gravity": [0.0, 9.81]}
    data["coordinates"] = {"knee_flexion": {"of": "knee.angle", "scale": -1}}
    path = [{"body": "ground", "point": [0.04, 0.22]}, {"body": "ground", "point": [0.06, 0.04]}]
    own = {"max_force": 5000.0, "optimal_length": 0.14, "tendon_length": 0.07, "patella": {}}
    data["muscles"] = {"vasti": {"path": path, **own, **muscle}}
    return data


def poses(flexion):
    """Return positions (T, 3) of the shank about the knee at the origin."""
    return np.stack([-0.19 * np.sin(flexion), -0.19 * np.cos(flexion), -flexion], axis=1)


def path_of(data, flexion):
    names = QuantityNames(mbdkit.Mechanism.from_spec(data))
    return MusclePath("vasti", names.mechanism.muscles["vasti"], names).at(np.zeros(len(flexion)), poses(flexion))


def turn(gradient, flexion):
    """Return the moment arms (T,) about the knee by derivatives (T, 3) of lengths, positive for extensors."""
    x, y = poses(flexion)[:, :2].T
    return y * gradient[:, 0] - x * gradient[:, 1] - gradient[:, 2]


def test_moment_arms_are_derivatives_of_the_length():
    step = 1e-6
    ahead, behind = (path_of(leg(), FLEXIONS + side * step).length for side in (1.0, -1.0))
    arms = turn(path_of(leg(), FLEXIONS).gradient, FLEXIONS)
    inside = ~np.isin(np.round(np.degrees(FLEXIONS)), (0, 100))  # the arm has a corner at 0 and 100 degrees
    np.testing.assert_allclose(arms[inside], ((ahead - behind) / (2 * step))[inside], rtol=0, atol=1e-9)


def test_an_arm_that_is_longer_by_a_deviation_is_that_of_another_person_at_all_angles():
    # deviations between persons: 4.2 of 42.6 mm at 0, 3.0 of 39.9 at 20, 2.9 of 37.7 at 40 degrees (Arch. Bone Jt.
    # Surg., article 16466); sources differ by 5 to 11 %
    flexion, step = np.radians([2.0, 20.0, 40.0, 70.0]), 1e-6
    arms = [turn(path_of(leg(patella={"deviations": n}), flexion).gradient, flexion) for n in (0.0, 1.0)]
    of_persons = np.array([4.2 / 42.6, 3.0 / 39.9, 2.9 / 37.7])
    ratio = arms[1] / arms[0] - 1.0
    assert np.all(ratio[:3] > of_persons)
    assert np.all(ratio[:3] < np.hypot(of_persons, 0.12))
    ahead, behind = (path_of(leg(patella={"deviations": 1.0}), flexion + s * step).length for s in (1.0, -1.0))
    np.testing.assert_allclose(arms[1], (ahead - behind) / (2 * step), rtol=0, atol=2e-5)


def test_moment_arms_are_those_of_other_knees():
    # F. T. Sheehan et al. in living men and women at 10 degrees; from 20 to 80 degrees the patella of Rajagopal2016 on
    # its published path, with a tendon from the middle of the thigh
    degrees = np.array([10, 10, 20, 30, 40, 50, 60, 70, 80])
    published = np.array([47.1, 45.5, 47.0, 46.5, 43.5, 40.2, 36.8, 31.8, 26.8]) / 1000
    flexion = np.radians(degrees)
    # margin: how far the source is from this model
    np.testing.assert_allclose(turn(path_of(leg(), flexion).gradient, flexion), published, rtol=0.13)


@pytest.mark.parametrize(("degrees", "ratio"), [(10, 1 / 0.86), (70, 1 / 1.55)])
def test_the_ligament_pulls_as_in_cadavers(degrees, ratio):
    """H.-U. Buff et al., J. Biomech. 21 (1988) 17-23."""
    # margin: how far the source is from this model
    assert np.interp(np.radians(degrees), FLEXION, SHARE) == pytest.approx(ratio, rel=0.13)


def test_the_patella_is_in_equilibrium():
    # The contact force is the sum of the pulls of tendon and ligament, up to the flexion from which the tendon lies on
    # the femur. Tendons run 5 degrees backward of the axis of the thigh.
    flexion, share = FLEXION[:8], SHARE[:8]
    between = flexion + ANGLE[:8] + np.radians(5.0)
    sizes = np.sqrt(1 + share**2 - 2 * share * np.cos(between))
    np.testing.assert_allclose(
        sizes, contact_share(flexion), rtol=0.13
    )  # margin: how far the source is from this model


@pytest.mark.parametrize("tendon", ["rigid", "elastic"])
@pytest.mark.parametrize("flexion", [0.2, 1.9])
def test_the_knee_carries_the_ligament(flexion, tendon):
    time = np.linspace(0.0, 1.0, 6)
    motion = {"data": {"time": time, "a": np.full(6, -flexion)}, "columns": {"knee.angle": "a"}, "errors": "none"}
    spec = {"mbdkit": 1, "model": leg(tendon=tendon), "motion": motion, "recruitment": {"minimum": 0.0}}
    with mbdkit.inverse(spec) as run:
        tension = run.muscles["vasti"].force
        along = np.interp(flexion, FLEXION, ANGLE) + flexion  # angle from up, forward
        ligament = np.interp(flexion, FLEXION, SHARE) * tension[:, None] * [np.sin(along), np.cos(along)]
        total = run.joints["knee"].reaction_force + ligament + [0.0, 9.81 * 3.5]
        np.testing.assert_allclose(total, 0.0, atol=1e-8)
        pressed = contact_share(np.array([flexion])) * tension
        np.testing.assert_allclose(run.knees["knee"].patellofemoral_force, pressed)


def acting(patella, integrator, formulation="index-1", **muscle):
    """Return a run of the leg, whose muscle acts."""
    model, time = leg(excitation="0.1 + 0.1*sin(9*t)", patella=patella, **muscle), {"end": 0.3, "step": 0.002}
    spec = {"mbdkit": 1, "model": model, "formulation": formulation}
    return mbdkit.run({**spec, "integrator": integrator, "time": time})


@pytest.mark.parametrize(
    ("tendon", "integrator", "formulation", "limit"),
    [
        ("rigid", "rk4", "index-1", 1e-5),  # the knee opens by 2e-8 m
        ("rigid", "gauss", "joint-coordinates", 1e-9),
        ("elastic", "radau-iia", "index-1", 1e-8),
    ],
)
def test_in_a_run_the_patella_extends_the_knee_and_the_knee_carries_the_ligament(
    tendon, integrator, formulation, limit
):
    # equations of motion of the shank, with the published lever arm, direction and share of the ligament
    with acting({"scale": 1.1}, {"name": integrator}, formulation, tendon=tendon) as run:
        pose, acceleration = (run.array(f"trajectory/{name}")[:, 0] for name in ("position", "acceleration"))
        flexion, tension = -pose[:, 2], run.muscles["vasti"].force
        assert flexion[-1] < -1.0
        moment = 1.1 * lever_arm(flexion) * tension + 9.81 * 3.5 * pose[:, 0]
        np.testing.assert_allclose((0.05 + 3.5 * 0.19**2) * acceleration[:, 2], moment, rtol=0, atol=limit)
        along = np.interp(flexion, FLEXION, ANGLE) + flexion
        ligament = np.interp(flexion, FLEXION, SHARE) * tension * [np.sin(along), np.cos(along)]
        total = run.joints["knee"].reaction_force + ligament.T + [0.0, 9.81 * 3.5] - 3.5 * acceleration[:, :2]
        np.testing.assert_allclose(total, 0.0, atol=limit)
        length = path_of(leg(patella={"scale": 1.1}), flexion).length
        np.testing.assert_allclose(run.muscles["vasti"].length, length, rtol=0, atol=limit)


def test_a_run_and_inverse_dynamics_know_the_same_arm_of_another_person():
    with acting({"deviations": -1.0}, {"name": "gauss", "stages": 2}) as run:
        flexion = -run["shank"].angle
        chosen = flexion > -1.0
        length = path_of(leg(patella={"deviations": -1.0}), flexion[chosen]).length
        # inverse dynamics sums scatter in steps of 1 degree, from -60 degrees on
        np.testing.assert_allclose(run.muscles["vasti"].length[chosen], length, rtol=0, atol=1e-6)


def test_runs_say_that_a_knee_bends_farther_than_the_data():
    model = leg(excitation=0.01)
    model["bodies"]["shank"] |= {"angle": -2.3, "position": poses(np.array([2.3]))[0, :2].tolist()}
    spec = {"mbdkit": 1, "model": model, "integrator": {"name": "gauss"}, "time": {"end": 0.01, "step": 0.001}}
    with mbdkit.run(spec) as run:
        assert "knee bends by 132 degrees, but data of the patella end at 120" in run.summary()


def test_a_guided_segment_needs_its_function(monkeypatch):
    monkeypatch.setattr(Lowering, "guide", lambda *_: None)
    with pytest.raises(PluginError, match="'vasti' has a guided segment without a function"):
        acting({}, {"name": "rk4"})


def test_a_patella_needs_a_pin_below_the_thigh():
    path = [{"body": "ground", "point": [0.04, 0.22]}, {"body": "shank", "point": [0.04, 0.1]}]
    with pytest.raises(SpecError, match="revolute joint whose first body is 'shank'"):
        path_of(leg(path=path), FLEXIONS)
    with pytest.raises(SpecError, match=r"model\.muscles\.vasti\.patella\.joint: there is no joint 'kne'"):
        acting({"joint": "kne"}, {"name": "rk4"})
    with pytest.raises(SpecError, match=r"vasti\.patella\.flexion: should be the angle of joint 'knee'"):
        acting({"flexion": "shank.x"}, {"name": "rk4"})


def squat(muscles, degrees=105):
    """Return inverse dynamics of a squat with this flexion of the knee and the muscles of an example."""
    data = read_source("squat").data
    data["parameters"] |= {"knee": f"degrees({degrees})", "ankle": "degrees(30)"}
    data["time"] = {"end": 3.0, "step": 0.03}
    with mbdkit.run(data) as run:
        trunk, thigh, shank, foot = (run[name].angle for name in ("trunk", "thigh", "shank", "foot"))
        (x, y), (fx, fy) = run.markers["hip"].position.T, run.joints["floor"].reaction_force.T
        columns = {"hip_x": x, "hip_y": y, "trunk_tilt": trunk, "hip_flexion": thigh - trunk}
        columns |= {"knee_flexion": thigh - shank, "ankle_dorsiflexion": foot - shank}
        pressed = (run.joints["floor"].reaction_torque - 0.0702 * fx) / fy
        load = {"time": run.time, "fx": fx, "fy": fy, "px": pressed, "py": 0.0 * fx}
        time = run.time
    model = {key: value for key, value in data["model"].items() if key not in ("joints", "hip_position")}
    spec = {
        "mbdkit": 1,
        "model": model | {"muscles": muscles},
        "motion": {"data": {"time": time, **columns}, "smooth": "quintic", "errors": "none"},
        "loads": {"ground": {"body": "foot", "force": ["fx", "fy"], "point": ["px", "py"], "data": load}},
        "recruitment": {"reserves": 1.0},
    }
    return mbdkit.inverse(spec)


def test_a_deep_squat_presses_the_knee_throughout():
    with squat("walking-two-legs") as run:
        force, angle = run.joints["knee"].reaction_force, run["shank"].angle
        along = np.sin(angle) * force[:, 0] - np.cos(angle) * force[:, 1]
        weight = 9.81 * 75 / 2
        assert np.min(along) > weight  # the ground presses with half of the weight, and muscles only add to it
        assert run.verdict != "bad"
        assert not any("data of the patella end" in one for one in run.warnings)
    with squat("walking-two-legs", 130) as run:
        assert any("knee bends by 130 degrees, but data of the patella end at 120" in one for one in run.warnings)


def test_a_knee_that_muscles_pull_apart_is_bad():
    with squat("walking-muscles") as run:
        assert run.verdict == "bad"
        assert any("knee is pulled: muscles leave a tension of" in reason for reason in run.verdict_reasons)
