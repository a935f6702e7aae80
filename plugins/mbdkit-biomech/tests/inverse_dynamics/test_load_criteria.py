"""Measured loads that contradict the motion or the model, and parts of models, are doubted; plausible ones are not."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from tests.inverse_dynamics.hanging_leg import ANGLES, NOISE, SMOOTH, T, leg, not_of_ends, stance, told

import mbdkit
from mbdkit import SpecError
from mbdkit.guide.pages import find_page
from mbdkit.mechanism.improbable_bodies import inertias_about_joints
from mbdkit.spec.loading import example_files
from mbdkit_biomech.inverse_dynamics.compute import InverseProblem, compute
from mbdkit_biomech.inverse_dynamics.criteria.data_verdict import doubts_about_data
from mbdkit_biomech.inverse_dynamics.criteria.load_criteria import load_doubts
from mbdkit_biomech.inverse_dynamics.criteria.load_point_criterion import forces_at_centres, missing_points
from mbdkit_biomech.inverse_dynamics.criteria.model_criteria import mechanism_doubts
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec


def test_a_centre_of_pressure_in_the_frame_of_the_laboratory_is_doubted() -> None:
    load = stance()
    far = stance(x=load["ground"]["data"]["x"] + 1.2)
    run = leg(loads=far)
    assert told(run) == {"load-point"}
    assert "acts outside of foot" in run.verdict_reasons[0]
    accepting = leg(loads=far, accept=["load-point"])
    assert accepting.verdict == "unknown"
    assert accepting.verdict_reasons == [f"Accepted by the spec: {run.verdict_reasons[0]}"]
    far["ground"]["kind"] = "other"
    plain = leg(loads=far)
    assert plain.verdict == "unknown"
    assert "never `good`, because error bars do not include errors of the model" in plain.summary()
    assert "never `good`" not in run.summary()


def test_a_force_at_the_centre_of_mass_for_want_of_a_point_is_told() -> None:
    (ground,) = stance().values()
    del ground["point"]
    data = {"time": T, "1_force_vy": ground["data"]["fy"], **{f"{plate}force_px": 0 * T for plate in ("", "1_")}}
    found: dict[str, tuple[list[str], list[str]]] = {}
    motion = {"data": {"time": T, **ANGLES}, "smooth": SMOOTH}
    for case, load in {
        "named": ground | {"data": data | {"1_force_vx": ground["data"]["fx"]}, "force": ["1_force_vx", "1_force_vy"]},
        "free": {"data": ground["data"], "body": "foot", "force": ["fx", "fy"]},
        "plate": ground | {"kind": "plate"},
        "other": ground | {"kind": "other"},
        "constant": ground | {"force": [3.0, 0.0]},
    }.items():
        spec = {"mbdkit": 1, "model": {"name": "leg"}, "motion": motion, "loads": {"ground": load}}
        problem = InverseProblem.of(load_inverse_spec(spec))
        found[case] = [one.sentence for one in missing_points(problem)], list(forces_at_centres(problem))
    at = "load 'ground' has no `point`, so that its force acts at the centre of mass of foot"
    otherwise = "give `point`, or write `kind: other` if the force does act at the centre of mass."
    assert found == {
        "named": ([f"{at}, but 1_force_px looks like its point of application: {otherwise}"], []),
        "free": ([], [f"{at}. Give `point` if it acts elsewhere, or write `kind: other`."]),
        "plate": ([f"{at}, although it is the load of a force plate: give `point`."], []),
        "other": ([], []),
        "constant": ([], []),
    }


def test_a_plate_may_lack_the_centre_of_pressure_while_its_force_is_small() -> None:
    data = stance()["ground"]["data"]
    up = np.maximum(data["fy"], 5.0)
    force = leg(loads=stance(fy=up, x=np.where(up < 10.0, np.nan, data["x"]))).loads["ground"].force
    assert force == pytest.approx(np.where(up < 10.0, 0.0, [data["fx"], up]).T)
    with pytest.raises(SpecError, match="the point of application is missing, although a force acts; give the point"):
        leg(loads=stance(fy=up, x=np.where(up < 25.0, np.nan, data["x"])))


def test_a_load_on_another_body_is_found_on_the_outline_of_its_own() -> None:
    load = stance()
    load["ground"]["body"] = "thigh"
    (reason,) = not_of_ends(leg(loads=load))
    assert "it is on the outline of foot: does the load act on that body?" in reason


def test_a_load_near_its_body_but_on_another_one_is_doubted() -> None:
    # the plate of the example, near the ankle of the shank, to which it is given
    for body, criteria in (("foot", set()), ("shank", {"load-point"})):
        spec = load_inverse_spec("walking", [f"loads.ground.body={body}"])
        doubts = doubts_about_data(compute(InverseProblem.of(spec)), None)
        assert {one.partition(":")[0] for one in doubts.open} == criteria
        assert all("does the load act on foot?" in one for one in doubts.open)


def test_the_force_on_the_plate_is_not_that_on_the_body() -> None:
    load = stance()["ground"]["data"]
    assert told(leg(loads=stance(fx=-load["fx"], fy=-load["fy"]))) == {"load-sign"}
    rounding = leg(loads=stance(fy=-3e-16 + 0 * T), motion={"errors": "none"})
    assert "load-sign" not in told(rounding)


def test_points_of_a_plate_that_are_declared_in_mm_but_look_like_metres_are_doubted() -> None:
    load = stance()
    load["ground"]["point"] = [{"column": "x", "unit": "mm"}, "y"]
    reasons = leg(loads=load, motion={"errors": "none"}).verdict_reasons
    assert any("in metres the same numbers are on foot: leave out the unit" in one for one in reasons), reasons


def test_a_plate_with_an_offset_is_doubted() -> None:
    load = stance()["ground"]["data"]
    assert told(leg(loads=stance(fy=load["fy"] + 20.0))) == {"load-offset"}


@pytest.mark.parametrize(
    ("factor", "delay", "cause"),
    [
        (1.0, 0.0, ""),
        (1.25, 0.0, "The loads seem to be too large: multiplied by 0.8, they fit. Or they are right, and"),
        (5.0, 0.0, "The loads fit a body of 10 kg, but the model has 2 kg. If it is a part of the body, such as a leg"),
        (-1.0, 0.0, "The loads seem to have the wrong sign."),
        (1.0, 0.05, "The loads seem to be 0.05 s too late."),
    ],
)
def test_a_load_that_contradicts_the_motion_of_a_free_body_is_explained(
    factor: float, delay: float, cause: str
) -> None:
    # a body of 2 kg that hops: the force that it needs is m (a + g)
    m = mbdkit.Mechanism()
    m.body("box", mass=2.0, inertia=0.1, position=(0.0, 0.2))
    m.marker("foot", "box", point=(0.0, -0.2))
    up = 2.0 * (9.81 - 0.1 * 36 * np.sin(6 * (T - delay)))
    data = {"box.x": 1e-4 * NOISE[0], "box.y": 0.2 + 0.1 * np.sin(6 * T) + 0.1 * NOISE[1], "box.angle": 0.1 * NOISE[2]}
    load = {"data": {"time": T, "fx": 0 * T, "fy": factor * up, "x": 0 * T}, "force": ["fx", "fy"], "point": ["x", 0.0]}
    motion = {"data": {"time": T, **data}, "smooth": SMOOTH}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": {"plate": {"body": "box", **load}}}
    run = mbdkit.inverse(spec)
    assert run.verdict == ("doubtful" if cause else "unknown"), run.verdict_reasons
    assert any(cause in reason for reason in run.verdict_reasons) == bool(cause)


def doubts_about(spec: dict[str, Any]) -> dict[str, str]:
    """Return the first doubt of each criterion about the data of a spec."""
    doubts = doubts_about_data(compute(InverseProblem.of(load_inverse_spec(spec, ()))), None).open
    return {one.partition(":")[0]: one for one in reversed(doubts)}


@pytest.mark.parametrize(
    ("column", "values", "criteria"),
    [
        pytest.param("fy", [], set(), id="clean"),
        pytest.param("fy", [0.0, 0.0, 0.0], {"outliers", "residuals"}, id="dropout"),
        pytest.param("fy", [2588.0], {"outliers", "residuals"}, id="spike-of-force"),
        pytest.param("px", [3.0], {"outliers", "residuals"}, id="spike-of-point"),
        pytest.param("mz", [200.0] * 5, {"outliers", "residuals"}, id="spike-of-torque"),
        pytest.param("fy", [611.0, 636.0, 661.0, 636.0, 611.0], {"residuals"}, id="spike-without-jumps"),
    ],
)
def test_a_glitch_of_a_plate_is_named_with_its_time(column: str, values: list[float], criteria: set[str]) -> None:
    # a body of 60 kg whose plate exerts what its prescribed motion needs, by Newton's and Euler's laws
    t = np.linspace(0, 2, 201)
    x, y = 0.05 * np.sin(2 * t), 1 + 0.03 * np.sin(3 * t)
    fx, fy, px = -60 * 0.2 * np.sin(2 * t), 60 * (9.81 - 0.27 * np.sin(3 * t)), x + 0.02 * np.sin(t)
    mz = -8 * 0.625 * np.sin(2.5 * t) - ((px - x) * fy + y * fx)
    data = {"time": t, "x": x, "y": y, "angle": 0.1 * np.sin(2.5 * t), "fx": fx, "fy": fy, "px": px, "mz": mz}
    data[column][100 : 100 + len(values)] = values
    body = {"mass": 60.0, "inertia": 8.0, "position": [0, 1.0]}
    motion = {"data": data, "columns": {f"body.{one}": one for one in ("x", "y", "angle")}, "smooth": "quintic"}
    load = {"body": "body", "force": ["fx", "fy"], "point": ["px", 0.0], "torque": "mz"}
    model = {"name": "mechanism", "bodies": {"body": body}}
    doubts = doubts_about({"mbdkit": 1, "model": model, "motion": motion, "loads": {"plate": load}})
    assert set(doubts) == criteria
    times = {1: "at t = 1 s", 3: "at t = 1 to 1.02 s", 5: "at t = 1 to 1.04 s"}
    if criteria == {"residuals"}:
        times[5] = "at t = 1.01 to 1.03 s"  # the rows beyond the limit
    assert all(times[len(values)] in one for one in doubts.values())


def of_leg(load: dict[str, Any]) -> dict[str, str]:
    """Return the doubts about the motion of the hanging leg with a load."""
    motion = {"data": {"time": T, **ANGLES}, "smooth": SMOOTH}
    return doubts_about({"mbdkit": 1, "model": {"name": "leg"}, "motion": motion, "loads": load})


def test_a_glitch_under_a_leg_that_hangs_at_its_hip_is_doubted_but_the_impact_of_a_heel_is_not() -> None:
    data = stance()["ground"]["data"]
    rows = np.arange(len(T))
    impact = 300 * np.exp(-0.5 * ((rows - 4) / 1.2) ** 2)  # 30 ms wide, 40 ms after the foot touches the ground
    assert set(of_leg(stance(fy=data["fy"] + impact))) == set()
    doubts = of_leg(stance(fy=np.where((rows == 40) | (rows == 60), 0.0, data["fy"])))
    assert set(doubts) == {"outliers"}
    assert "at t = 0.4 s and 0.6 s. The largest one is in the force along y" in doubts["outliers"]


@pytest.mark.parametrize("least", [pytest.param(-1.0, id="always"), pytest.param(500.0, id="under-large-forces")])
def test_a_coordinate_of_the_point_that_is_exactly_zero_under_load_was_lost(least: float) -> None:
    data = stance()["ground"]["data"]
    doubts = of_leg(stance(x=np.where(data["fy"] > least, 0.0, data["x"])))
    assert set(doubts) == {"constant"}
    assert "coordinate x of the point of load 'ground' is exactly zero in " in doubts["constant"]


def test_a_point_in_millimetres_that_crosses_zero_was_not_lost() -> None:
    data = stance()["ground"]["data"]
    x = np.round(data["x"] - data["x"][50], 3)
    assert "constant" not in of_leg(stance(x=x))


@pytest.mark.parametrize(
    ("fall", "carried"), [pytest.param(0.0, True, id="stands"), pytest.param(9.81, False, id="flies")]
)
def test_the_weight_of_a_free_body_without_loads_is_doubted_except_in_flight(fall: float, carried: bool) -> None:
    m = mbdkit.Mechanism()
    m.body("box", mass=2.0, inertia=0.1)
    data = {"time": T, "box.x": T, "box.y": 5 * T - fall / 2 * T**2 + 0.01 * NOISE[0], "box.angle": 0.5 * T}
    spec = {"mbdkit": 1, "model": m.to_spec(), "motion": {"data": data, "smooth": SMOOTH}}
    run = mbdkit.inverse(spec)
    assert told(run) == ({"residuals"} if carried else set())
    cause = " times the weight of the model. Without loads, these forces carry the model: is the load of a force plate "
    assert any(cause in reason for reason in run.verdict_reasons) == carried
    declared = {"lift": {"body": "box", "coordinate": "y"}}
    assert "residuals" not in told(mbdkit.inverse(spec | {"actuators": declared}))


def test_a_body_at_rest_with_a_load_at_the_start_only_is_doubted_without_dividing_by_zero() -> None:
    m = mbdkit.Mechanism()
    m.body("box", mass=2.0, inertia=0.1)
    motion = {"data": {"time": T, "box.x": 0 * T, "box.y": 0 * T, "box.angle": 0 * T}, "smooth": SMOOTH}
    load = {"body": "box", "data": {"time": T, "fy": np.where(T < 0.03, 10.0, 0.0)}, "force": [0.0, "fy"]}
    run = mbdkit.inverse({"mbdkit": 1, "model": m.to_spec(), "motion": motion, "loads": {"hand": load}})
    assert "residuals" in told(run)


def late(delay: float) -> dict[str, Any]:
    """Return the load of the example `walking` with a delay [s]."""
    lines = [line for line in example_files("walking")["walking.csv"].splitlines() if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True)
    data = {"time": table["time"]}
    for name in ("force_x", "force_y", "pressure_x"):
        known = ~np.isnan(table[name])
        data[name] = np.interp(table["time"] - delay, table["time"][known], table[name][known])
    # of up to 800 N times 1 cm, as a plate may have, with a factor of 1000 because it is in N mm
    data["torque"] = 10.0 * data["force_y"] * np.sin(9 * table["time"])
    return {"body": "foot", "data": data, "force": ["force_x", "force_y"], "point": ["pressure_x", 0.0]}


def in_grams() -> dict[str, Any]:
    """Return the model of the example `walking` with its masses in g, and its inertias in g m^2, in place of kg."""
    model = load_inverse_spec("walking").mechanism().to_spec()
    for body in model["bodies"].values():
        body |= {"mass": 1e3 * body["mass"], "inertia": 1e3 * body["inertia"]}
    return model


def of_plate(x: Any, y: Any) -> dict[str, Any]:
    """Return the loads of the example `walking` with other columns of the force."""
    return {"loads": {"ground": late(0.0) | {"force": [x, y]}}}


def heavy_foot() -> dict[str, Any]:
    """Return the model of the example `walking` with the inertia of the foot in kg cm^2 in place of kg m^2."""
    model = load_inverse_spec("walking").mechanism().to_spec()
    model["bodies"]["foot"]["inertia"] *= 1e4
    return model


@pytest.mark.parametrize(
    ("sections", "criteria"),
    [
        pytest.param({}, set(), id="clean"),
        pytest.param({"loads": {"ground": late(0.0) | {"torque": "torque"}}}, {"load-point"}, id="torque-in-N-mm"),
        pytest.param({"loads": {"ground": late(0.1)}}, {"load-time"}, id="late"),
        pytest.param({"loads": {"ground": late(-0.1)}}, {"load-time"}, id="early"),
        pytest.param(of_plate({"column": "force_x", "scale": -1}, "force_y"), {"load-sign"}, id="sign-of-x"),
        pytest.param(of_plate("force_x", 0.0), {"load-direction"}, id="no-vertical-force"),
        pytest.param(
            of_plate(*({"column": f"force_{axis}", "unit": "kN"} for axis in "xy")), {"residual-size"}, id="N-as-kN"
        ),
        pytest.param({"model": in_grams()}, {"residual-size"}, id="masses-in-g"),
        pytest.param({"cutoff": 3.0}, {"cutoff"}, id="low-cutoff"),
        pytest.param({"model": heavy_foot()}, {"inertia"}, id="inertia-in-kg-cm2"),
    ],
)
def test_other_criteria_find_faults_of_loads_and_masses_if_residuals_are_accepted(
    sections: dict[str, Any], criteria: set[str]
) -> None:
    overrides = [f"motion.smooth.cutoff={sections['cutoff']}"] if "cutoff" in sections else []
    given = {name: one for name, one in sections.items() if name != "cutoff"}
    doubts = doubts_about_data(compute(InverseProblem.of(load_inverse_spec("walking", overrides, **given))), None)
    assert {one.partition(":")[0] for one in doubts.open} == criteria
    assert {one.partition(":")[0] for one in doubts.accepted} == {"residuals"}
    assert all(" times the largest load and " in one for one in doubts.accepted)
    delays = [float(one.split()[7]) for one in doubts.open if one.startswith("load-time")]
    assert delays == pytest.approx([0.1] * len(delays), abs=0.01)  # margin: resolution of the rows


@pytest.mark.parametrize("span", [{"end": 0.57}, {"end": 0.785}, {"end": 0.894}, {"start": 2.286}, {"start": 2.5}])
def test_a_stance_that_the_span_of_time_cuts_makes_no_load_late(span: dict[str, float]) -> None:
    result = compute(InverseProblem.of(load_inverse_spec("walking-two-legs", time=span)))
    assert not [one for one in load_doubts(result, None) if one.criterion == "load-time"]


@pytest.mark.parametrize(
    ("inertia", "mass", "told"),
    [
        # shank of 3.5 kg and 0.42 m: 0.302, 0.528 and 0.643 lengths about centre, knee and ankle (Winter, table 4.1)
        pytest.param(3.5 * (0.302 * 0.42) ** 2, 3.5, False, id="about the centre of mass"),
        pytest.param(3.5 * (0.528 * 0.42) ** 2, 3.5, True, id="about the knee"),
        pytest.param(3.5 * (0.643 * 0.42) ** 2, 3.5, True, id="about the ankle"),
        pytest.param(3.5 * 0.21**2, 3.5, False, id="masses at both ends"),
        pytest.param(3.5 * 0.42**2, 3.5, False, id="larger than its points"),
        pytest.param(0.05 * 0.25**2, 0.05, False, id="light body"),
        pytest.param(None, 3.5, False, id="point mass"),
    ],
)
def test_an_inertia_about_a_joint_is_told(inertia: float | None, mass: float, told: bool) -> None:
    m = mbdkit.Mechanism()
    m.body("thigh", mass=8.0, inertia=0.1)
    m.body("shank", mass=mass, inertia=inertia)
    m.revolute("knee", "thigh", "shank", points=((-0.24, 0), (0.18, 0)))
    m.marker("ankle", "shank", point=(-0.24, 0.0))
    found = [*inertias_about_joints(m)]
    assert len(found) == told
    assert all("of body 'shank' at model.bodies.shank" in text for text in found)


def test_a_model_says_what_it_leaves_out_as_printed() -> None:
    section = find_page("plugins").text.split("# A model in twenty lines\n", 1)[1].split("\n#", 1)[0]
    m = mbdkit.Mechanism()
    exec(re.findall(r"^```python\n(.*?)^```", section, flags=re.MULTILINE | re.DOTALL)[1], {"m": m})
    assert [one.criterion for one in mechanism_doubts(m)] == ["left-out"]
    assert len(m.warnings) == 1
