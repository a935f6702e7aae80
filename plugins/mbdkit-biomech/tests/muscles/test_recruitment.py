"""Recruitment and its gradients: against OpenSim's static optimization, closed forms, and identities."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.muscles import leg
from tests.muscles.forearm import forearm
from tests.muscles.recruited import leg_spec
from tests.muscles.shared_loads import FRAMES, by_casadi, problems

import mbdkit
from mbdkit import RunError, SpecError
from mbdkit_biomech.inverse_dynamics.gradient.recruitment_gradient import ProgrammeChange, change_of_shares
from mbdkit_biomech.inverse_dynamics.muscles.shared_loads import share_loads
from mbdkit_report import report
from tests.margins import assert_within

OPENSIM = json.loads((Path(__file__).parent / "opensim_muscles.json").read_text())["recruitment"]
INSIDE = slice(2, -2)
"""OpenSim differentiates the motion by splines, whose ends are less accurate."""


@pytest.fixture(scope="module")
def walked():
    with mbdkit.inverse(leg_spec()) as run:
        yield run


def test_activations_are_those_of_opensims_static_optimization(walked):
    for name, theirs in OPENSIM["activation"].items():
        np.testing.assert_allclose(
            walked.muscles[name].activation[INSIDE], np.array(theirs)[INSIDE], rtol=0, atol=2e-3, err_msg=name
        )


def test_joints_carry_the_forces_that_they_carry_in_opensim_with_equal_muscles():
    wanted = json.loads((Path(__file__).parent / "opensim_muscles.json").read_text())["postures"]
    spec = leg_spec(leg.HOLDING, changed={"pennation": 0.14}, capacity="isometric", minimum=0.0)
    columns = spec["motion"]["columns"]
    for angles, posture in zip(leg.POSTURES, wanted, strict=True):
        data = {"time": [0.0, 0.1, 0.2, 0.3, 0.4], "zero": [0.0] * 5}
        data |= {name: [angle] * 5 for name, angle in zip(("hip", "knee"), angles, strict=True)}
        at_rest = {key: one | {"rate": "zero", "acceleration": "zero"} for key, one in columns.items()}
        run = mbdkit.inverse(spec | {"motion": {"data": data, "columns": at_rest}})
        for name, force in posture["muscles"].items():
            assert run.muscles[name].force[2] == pytest.approx(force, rel=1e-9)
        for name, force in posture["joints"].items():
            peak = np.linalg.norm(force)
            np.testing.assert_allclose(run.joints[name].reaction_force[2], force, rtol=0, atol=1e-9 * peak)


def test_power_of_muscles_is_that_of_the_moments_and_energy_is_balanced(walked):
    muscles = sum(muscle.power for muscle in walked.muscles.values())
    actuators = sum(actuator.power for actuator in walked.actuators.values())
    np.testing.assert_allclose(muscles, actuators, rtol=0, atol=1e-10)
    assert_within(walked.energy.balance, 1e-4)


def test_moment_arms_follow_the_sign_and_scale_of_a_coordinate(walked):
    spec = leg_spec()
    spec["model"]["coordinates"]["flexion"] = {"of": "knee.angle", "scale": -2.0}
    run = mbdkit.inverse(spec)
    np.testing.assert_allclose(
        run.moment_arms("wrapped", "flexion"), -0.5 * walked.moment_arms("wrapped", "knee.angle"), rtol=0, atol=1e-14
    )
    with pytest.raises(mbdkit.MbdkitError, match="no muscle 'wraped'"):
        run.moment_arms("wraped", "flexion")


def test_the_elbow_of_a_resting_forearm_carries_the_muscle_less_the_weight():
    weight = 1.5 * 9.81
    force = weight * 0.15 / 0.04
    run = mbdkit.inverse(forearm(measures={"pull": {"value": "max(muscles.biceps.force)", "unit": "N"}}))
    np.testing.assert_allclose(run.muscles["biceps"].force, force, rtol=1e-12)
    np.testing.assert_allclose(run.muscles["biceps"].activation, force / 600.0, rtol=1e-12)
    np.testing.assert_allclose(run.joints["elbow"].reaction_force[:, 1], weight - force, rtol=1e-12)
    np.testing.assert_allclose(run.array("muscles/reaction_force_without")[:, 0, 1], weight, rtol=1e-12)
    assert run.measures["pull"] == pytest.approx(force, rel=1e-12)
    summary = run.summary()
    assert f"elbow {force - weight:.6g} N, {weight:.4g} N without muscles" in summary
    assert "reserves      none" in summary


def test_the_report_says_what_joints_carry_and_what_reserves_exert(tmp_path):
    spec = forearm(recruitment={"capacity": "isometric", "reserves": {"elbow": 2.0}})
    mbdkit.inverse(spec, archive=tmp_path / "arm.h5").close()
    text = report(tmp_path / "arm.h5", tmp_path / "arm.html").read_text(encoding="utf-8")
    share = 1 / (1 + (0.04 * 600 / 2) ** 2)
    assert f"Reserves exert {share:.2%} of elbow" in text
    assert "Largest joint forces" in text
    assert "Joint forces with and without muscles" in text
    assert "Activations of the muscles" in text


def test_reserves_share_the_moment_by_their_optimal_force_and_are_reported():
    # minimise (F / 600)^2 + (r / 2)^2 subject to 0.04 F + r = M
    moment = 1.5 * 9.81 * 0.15
    run = mbdkit.inverse(forearm(recruitment={"capacity": "isometric", "reserves": {"elbow": 2.0}}))
    reserve = moment / (1 + (0.04 * 600 / 2) ** 2)
    np.testing.assert_allclose(run.actuators["reserve.elbow"].value, reserve, rtol=1e-12)
    np.testing.assert_allclose(run.muscles["biceps"].force, (moment - reserve) / 0.04, rtol=1e-12)
    np.testing.assert_allclose(run.actuators["elbow"].value, moment, rtol=1e-12)
    assert f"reserves      elbow {reserve / moment:.2%}" in run.summary()


def test_full_capacity_and_passive_force_bound_the_activation():
    from mbdkit_biomech.muscles.force_curves import CURVES

    length = np.array([(0.3 - 0.18) / 0.12])
    force = 1.5 * 9.81 * 0.15 / 0.04
    curves = CURVES["de-groote-fregly"]
    active, passive = (600.0 * curve(length)[0][0] for curve in (curves.active, curves.passive))
    active *= curves.velocity(0 * length)[0][0]
    for is_passive in (False, True):
        run = mbdkit.inverse(forearm(recruitment={"passive": is_passive}))
        wanted = (force - is_passive * passive) / active
        np.testing.assert_allclose(run.muscles["biceps"].activation, wanted, rtol=1e-12)
        np.testing.assert_allclose(run.muscles["biceps"].fiber_length, 0.12, rtol=1e-12)


def test_frames_that_muscles_cannot_produce_are_named_with_the_smallest_reserves():
    moment = 1.5 * 9.81 * 0.15
    spec = forearm()
    spec["model"]["muscles"]["biceps"]["max_force"] = 20.0
    lacking = moment - 0.04 * 20.0
    with pytest.raises(RunError, match="cannot produce the motion in 11 of 11 frames") as error:
        mbdkit.inverse(spec)
    assert f"elbow {lacking:.4g} N m" in str(error.value)
    run = mbdkit.inverse(spec | {"recruitment": {"capacity": "isometric", "reserves": 1.0}})
    np.testing.assert_allclose(run.actuators["reserve.elbow"].value, lacking, rtol=1e-10)


def test_a_muscle_that_is_too_strong_for_the_minimum_activation_is_named():
    # expected: by hand; the smallest moment is 0.01 * 0.04 m * max_force
    moment = 1.5 * 9.81 * 0.15
    spec = forearm(recruitment={"minimum": 0.01, "capacity": "isometric"})
    muscles = spec["model"]["muscles"]
    below = {"body": "ground", "point": [0.04, -0.3]}
    muscles["triceps"] = muscles["biceps"] | {"path": [below, muscles["biceps"]["path"][1]]}
    muscles["biceps"]["max_force"] = 6e5
    with pytest.raises(RunError, match="prevents the motion in 11 of 11 frames") as error:
        mbdkit.inverse(spec)
    assert f"elbow needs {moment:.4g} N m, but muscle 'biceps' alone exerts 240 N m" in str(error.value)


@pytest.mark.parametrize(
    ("changes", "criteria"),
    [
        # expected: by hand; the elbow needs 2.2 N m with an arm of 0.04 m, and fibres of 0.12 m fit the path
        ({}, set()),
        ({"max_force": 20.0}, {"reserves"}),
        ({"max_force": 0.3}, {"reserves", "max-force"}),
        ({"optimal_length": 0.05}, {"reserves", "fibers"}),  # 2.4 optimal lengths
        ({"optimal_length": 0.08}, set()),
    ],
)
def test_muscles_that_cannot_produce_the_motion_alone_make_the_verdict_doubtful(changes, criteria):
    spec = forearm(recruitment={"reserves": 1.0})
    spec["model"]["muscles"]["biceps"] |= changes
    run = mbdkit.inverse(spec)
    assert {reason.partition(":")[0] for reason in run.verdict_reasons} == criteria
    assert run.verdict == ("doubtful" if criteria else "unknown")
    if "max-force" in criteria:
        accepted = mbdkit.inverse(spec | {"accept": sorted(criteria)})
        assert accepted.verdict == "unknown"
        assert all(reason.startswith("Accepted by the spec: ") for reason in accepted.verdict_reasons)


@pytest.mark.parametrize(
    ("recruitment", "key", "message"),
    [
        ({"exponent": 0}, "recruitment.exponent", "at least 1"),
        ({"minimum": 1.0}, "recruitment.minimum", "less than 1"),
        ({"reserves": {"elbo": 1.0}}, "recruitment.reserves.elbo", "there is no actuator 'elbo'"),
        ({"power": 2}, "recruitment.power", "unknown key"),
    ],
)
def test_wrong_recruitment_gets_one_sentence_with_its_key(recruitment, key, message):
    with pytest.raises(SpecError) as error:
        mbdkit.inverse(forearm(recruitment=recruitment))
    assert error.value.key == key
    assert message in str(error.value)


def test_recruitment_needs_muscles_and_muscles_without_it_are_told():
    spec = forearm()
    del spec["recruitment"]
    run = mbdkit.inverse(spec)
    assert any("exert no force because the spec has no `recruitment`" in warning for warning in run.warnings)
    assert list(run.muscles) == []
    del spec["model"]["muscles"]
    with pytest.raises(SpecError, match="needs muscles, but the model has none"):
        mbdkit.inverse(spec | {"recruitment": {}})


@pytest.mark.parametrize("exponent", [1, 3, "inf"])
def test_all_exponents_produce_the_moments(exponent):
    spec = leg_spec(exponent=exponent, reserves=1.0)
    run = mbdkit.inverse(spec)
    assert_within(run.array("muscles/certificate"), 1e-9)
    moment = sum(run.moment_arms(name, "knee.angle") * muscle.force for name, muscle in run.muscles.items())
    whole = moment + run.actuators["reserve.knee"].value
    np.testing.assert_allclose(whole, run.actuators["knee"].value, rtol=0, atol=1e-8)


def test_error_bars_of_tensions_cover_the_errors_of_noisy_angles():
    random = np.random.default_rng(5)
    exact = mbdkit.inverse(leg_spec(changed={"curves": "de-groote-fregly"}, capacity="isometric"))
    spec = leg_spec(changed={"curves": "de-groote-fregly"}, capacity="isometric")
    data, columns = spec["motion"]["data"], {}
    for name in ("hip", "knee"):
        data[name] = (np.array(data[name]) + random.normal(0, 1e-3, 81)).tolist()
        columns[f"{name}.angle"] = {"column": name, "deviation": 1e-3}
    spec["motion"] = {"data": data, "columns": columns, "smooth": {"name": "butterworth", "cutoff": 8}}
    run = mbdkit.inverse(spec)
    inside = slice(10, -10)
    covered = [
        np.mean(np.abs(one.force - exact.muscles[name].force)[inside] <= one.force_error[inside] + 1e-9)
        for name, one in run.muscles.items()
    ]
    assert np.mean(covered) > 0.85
    sizes = [np.median(one.force_error[inside]) for one in run.muscles.values()]
    assert max(sizes) < 0.3 * max(np.max(one.force) for one in run.muscles.values())


@pytest.mark.parametrize("reserves", [0.0, 20.0])
def test_derivatives_of_shares_are_differences_of_an_active_set_method(reserves):
    programme = problems(reserves)
    random = np.random.default_rng(8)
    matrix = programme.matrix * random.uniform(-1, 1, programme.matrix.shape)
    right, weight = 0.1 * programme.size * random.uniform(-1, 1, programme.right.shape), 0 * programme.weight
    found = change_of_shares(programme, share_loads(programme, 2.0), 2.0, ProgrammeChange(matrix, right, weight))
    for row in range(0, FRAMES, 3):

        def at(step, row=row):
            return by_casadi(
                replace(programme, matrix=programme.matrix + step * matrix, right=programme.right + step * right),
                row,
                2,
            )

        near, far = ((at(step) - at(-step)) / (2 * step) for step in (2e-4, 4e-4))
        np.testing.assert_allclose(found[row], (4 * near - far) / 3, rtol=0, atol=1e-7 * np.max(np.abs(found[row])))


def test_contact_force_of_a_held_forearm_has_the_derivatives_of_its_closed_form():
    # minimise (F / C)^2 + (r / 2)^2 subject to 0.04 F + r = 0.15 m g: r = M / (1 + (0.04 C / 2)^2); the elbow carries
    # m g - F
    spec = forearm(recruitment={"capacity": "isometric", "reserves": {"elbow": 2.0}})
    mass, capacity = "model.bodies.forearm.mass", "model.muscles.biceps.max_force"
    share = 1 / (1 + (0.04 * 600 / 2) ** 2)
    pull = 9.81 * 0.15 * (1 - share) / 0.04
    by_capacity = 1.5 * 9.81 * 0.15 / 0.04 * share**2 * 2 * (0.04 / 2) ** 2 * 600
    measures = ["final(joints.elbow.force_y)", 'final(actuators["reserve.elbow"].value)', "final(muscles.biceps.force)"]
    found = mbdkit.inverse_gradient(spec, measures, [mass, capacity])
    expected = [[9.81 - pull, -by_capacity], [9.81 * 0.15 * share, -0.04 * by_capacity], [pull, by_capacity]]
    np.testing.assert_allclose(found.jacobian, expected, rtol=1e-9)
    assert found.check is not None
    assert found.check.is_passed


MEASURES = [
    "mean(joints.knee.force_x**2)", "final(joints.hip.force_y)", "mean(muscles.wrapped.force)",
    "mean(muscles.via.activation)", "at(muscles.straight.power, 0.3)", 'mean(actuators["reserve.knee"].power)',
    "final(energy.work)",
]  # fmt: skip
PARAMETERS = [
    "model.forces.spring.stiffness",
    "model.muscles.via.optimal_length",
    "model.muscles.straight.weight",
    "model.joints.knee.points.1.1",  # moves the leg
]


@pytest.mark.parametrize(("exponent", "parameters"), [(2, PARAMETERS), (3, PARAMETERS[:1])])
def test_contact_forces_and_muscles_have_the_derivatives_of_differences(exponent, parameters):
    spec = leg_spec(changed={"curves": "de-groote-fregly"}, exponent=exponent, reserves=200.0, passive=True)
    spring = {"type": "torsion-spring", "bodies": ["thigh", "shank"], "stiffness": 20.0, "free_angle": -0.2}
    spec["model"]["forces"] = {"spring": spring}
    found = mbdkit.inverse_gradient(spec, MEASURES, parameters)
    check = found.check
    assert check is not None
    assert check.is_passed, str(found)
    np.testing.assert_allclose(check.derivative, check.extrapolated, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("exponent", [1, "inf"])
def test_linear_programmes_have_no_gradient(exponent):
    with pytest.raises(SpecError, match=f"an exponent of 2 or more, not {exponent}") as error:
        mbdkit.inverse_gradient(
            forearm(recruitment={"exponent": exponent}), "final(muscles.biceps.force)", "model.bodies.forearm.mass"
        )
    assert error.value.key == "recruitment.exponent"
