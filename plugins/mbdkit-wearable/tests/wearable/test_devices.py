"""Devices on persons: closed forms of a misplaced hinge, limits of stiff and soft cuffs, names, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit import load_spec
from tests.margins import assert_within

H = 1.75
ARM, KNEE, TOP = 0.09 * H, -0.245 * H, 0.433 * 0.246 * H
"""Distance of the cuffs from the knee, height of the knee from the hip, and above the centre of the shank [m]."""
CUFF = {"axis": [1, 0], "stiffness": {"normal": 2e4, "tangential": 1e4, "rotation": 20.0}}
AT = {"upper": ("thigh", [0.0, ARM - 0.567 * 0.245 * H]), "lower": ("shank", [0.0, TOP - ARM])}
HELD = {"name": "gauss"}


def device(mechanism: dict[str, Any], cuff: dict[str, Any] = CUFF, **keys: Any) -> dict[str, Any]:
    """Return the section of a device of the knee."""
    attach = {link: {"limb": limb, "at": at, "cuff": cuff} for link, (limb, at) in AT.items()}
    return {"mechanism": mechanism, "attach": attach, **keys}


def spec(devices: dict[str, Any], flexion: float = 1.0, **model: Any) -> dict[str, Any]:
    """Return the spec of a leg on a fixed hip, whose joints drivers hold, without gravity."""
    joints = {
        "hip_motor": {"type": "driver", "bodies": ["ground", "thigh"], "coordinate": "angle", "motion": 0.3},
        "knee_motor": {"type": "driver", "bodies": ["thigh", "shank"], "coordinate": "angle", "motion": -flexion},
        "ankle_motor": {"type": "driver", "bodies": ["shank", "foot"], "coordinate": "angle", "motion": 0.0},
    }
    pose = {"hip_flexion": 0.3, "knee_flexion": flexion}
    base = {"name": "leg", "height": H, "gravity": [0, 0], **pose, "joints": joints, "devices": devices}
    return {"mbdkit": 1, "model": base | model, "integrator": HELD, "time": {"end": 0.01, "step": 0.01}}


def forces_at_rest(devices: dict[str, Any], flexion: float = 1.0) -> tuple[np.ndarray, float]:
    """Return the force in the knee, and the torque of the driver of the knee, in equilibrium."""
    rest = mbdkit.equilibrium(spec(devices, flexion))
    place = {name: k for k, name in enumerate(rest.joints)}
    return rest.reaction_force[place["knee"]], float(rest.reaction_torque[place["knee_motor"]])


def leg_with_hinge(offset: tuple[float, float], motion: str | None, cuff: dict[str, Any]) -> mbdkit.Mechanism:
    """Return a shank that a driver turns about the origin, and a link that turns about a hinge at an offset."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    for name in ("shank", "link"):
        m.body(name, mass=1.0, inertia=0.01, position=(0.0, -0.2))
    m.revolute("knee", m.ground, "shank", at=(0.0, 0.0))
    m.revolute("hinge", m.ground, "link", at=offset)
    m.driver("bend", m.ground, "shank", coordinate="angle", motion="-2*t")
    if motion is not None:
        m.driver("follow", m.ground, "link", coordinate="angle", motion=motion)
    m.cuff("cuff", bodies=("shank", "link"), at=(0.03, 0.05), axis=(0.3, 1.0), **cuff)
    return m


def test_a_misplaced_hinge_with_the_angle_of_the_knee_displaces_its_cuff_by_2_e_sin_half_the_angle() -> None:
    e, k = np.hypot(0.02, -0.01), 8e3
    m = leg_with_hinge((0.02, -0.01), "-2*t", {"stiffness": {"normal": k, "tangential": k}})
    run = mbdkit.run(m, integrator={"name": "gauss", "stages": 3}, time={"end": 1.0, "step": 0.01})
    cuff, expected = run.cuffs["cuff"], 2.0 * e * np.sin(run.time)  # the angle is 2 t
    assert np.linalg.norm(cuff.displacement, axis=1) == pytest.approx(expected, abs=1e-12)
    assert np.hypot(cuff.normal_force, cuff.shear_force) == pytest.approx(k * expected, abs=1e-8)


def test_a_free_hinge_takes_the_angle_of_least_energy() -> None:
    # |a + R(phi) b| is least where R(phi) b is opposite to a: the energy is k (|a| - |b|)^2 / 2
    k, angle = 8e3, -0.8
    hinge, on_shank = np.array([0.02, -0.01]), np.array([0.03, -0.15])
    m = leg_with_hinge((0.02, -0.01), None, {"stiffness": {"normal": k, "tangential": k}})
    rest = mbdkit.equilibrium(m, time={"start": -angle / 2.0, "end": 1.0, "step": 0.1}, integrator=HELD)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    a, b = hinge - turn @ on_shank, on_shank - hinge
    expected = np.arctan2(-a[1], -a[0]) - np.arctan2(b[1], b[0])
    assert rest.position[1, 2] == pytest.approx(expected, abs=1e-9)
    force = np.linalg.norm(rest.reaction_force[rest.joints.index("hinge")])
    assert force == pytest.approx(k * abs(np.linalg.norm(a) - np.linalg.norm(b)), rel=1e-9)


def test_assistance_passes_without_loss_where_the_device_fits() -> None:
    # by virtual work, the torque arrives if the motion of the knee does not displace the cuffs; a hinge that fits is
    # displaced by its own torque, so that its loss is proportional to the torque, and none for a small one
    for rotation in (5.0, 500.0):
        cuff = {**CUFF, "stiffness": {"normal": 3e3, "tangential": 1e3, "rotation": rotation}}
        own = {"name": "self-aligning-orthosis", "height": H, "motor": 12.0}
        force, torque = forces_at_rest({"d": device(own, cuff)})
        assert torque == pytest.approx(-12.0, abs=1e-9)
        assert_within(np.linalg.norm(force), 1e-9)
    losses = []
    for motor in (1e-2, 1e-3):
        own = {"name": "hinge-orthosis", "height": H, "motor": motor}
        losses.append(1.0 + forces_at_rest({"d": device(own)})[1] / motor)
    assert_within(losses[1], 1e-4)
    assert losses[1] == pytest.approx(losses[0] / 10.0, rel=0.01)


def centred() -> dict[str, Any]:
    """Return a self-aligning device with a spring that pulls its hinge to the upper link."""
    own = {"mbdkit": 1, "model": {"name": "self-aligning-orthosis", "height": H}, "integrator": HELD}
    model = load_spec({**own, "time": {"end": 1.0, "step": 1.0}}).mechanism().to_spec()
    model["forces"] = {
        "centring": {"type": "spring-damper", "bodies": ["upper", "across"], "points": [[0.1, -0.1], [0.0, 0.0]],
                     "stiffness": 2000.0, "free_length": 0.05}
    }  # fmt: skip
    return model


def test_a_misplaced_device_loads_the_knee_as_welded_if_cuffs_are_stiff_and_not_at_all_if_they_are_soft() -> None:
    offset, own = [0.02, 0.01, 0.0], centred()
    built = load_spec(spec({"d": device(own, offset=offset)})).mechanism()
    welded = mbdkit.Mechanism.from_spec({key: value for key, value in built.to_spec().items() if key != "cuffs"})
    for name, cuff in built.cuffs.items():
        welded.weld(f"weld.{name}", *cuff.bodies, points=cuff.ends, angle=cuff.angle)
    rest = mbdkit.equilibrium(welded)
    rigid = rest.reaction_force[rest.joints.index("knee")]
    assert np.linalg.norm(rigid) > 50.0
    gaps, loads = [], []
    for scale in (1e3, 1e4):
        stiff = {"stiffness": {key: scale * value for key, value in CUFF["stiffness"].items()}}
        gaps.append(np.linalg.norm(forces_at_rest({"d": device(own, stiff, offset=offset)})[0] - rigid))
        soft = {"stiffness": {key: value / scale for key, value in CUFF["stiffness"].items()}}
        hinge = {"name": "hinge-orthosis", "height": H}
        loads.append(np.linalg.norm(forces_at_rest({"d": device(hinge, soft, offset=offset)})[0]))
    assert gaps[1] == pytest.approx(gaps[0] / 10.0, rel=0.01)
    assert loads[1] == pytest.approx(loads[0] / 10.0, rel=0.01)


@pytest.mark.parametrize("name", ["hinge-orthosis", "four-bar-orthosis", "geared-orthosis", "self-aligning-orthosis"])
def test_a_device_that_fits_is_at_rest_with_the_straight_leg_and_closes_with_the_bent_one(name: str) -> None:
    straight = load_spec(spec({"d": device({"name": name, "height": H}, offset=[0.01, -0.02, 0.1])}, 0.0)).mechanism()
    rest = mbdkit.equilibrium(straight)
    assert_within(rest.reaction_force, 1e-8)
    bent = mbdkit.run(spec({"d": device({"name": name, "height": H})}, 1.2))
    assert_within(max(joint.misalignment[0] for joint in bent.joints.values()), 1e-12)
    gap = np.concatenate([cuff.displacement[0] for cuff in bent.cuffs.values()])
    assert_within(gap, 0.04)
    if name == "geared-orthosis":  # sectors of equal size: the plate halves the angle
        angles = [bent[f"d.{body}"].angle[0] for body in ("upper", "plate", "lower")]
        assert angles[1] == pytest.approx((angles[0] + angles[2]) / 2.0, abs=1e-12)


def test_names_in_files_get_the_name_of_the_device_in_front(tmp_path: Path) -> None:
    (tmp_path / "brace.yaml").write_text("""
mbdkit: 1
parameters: {k: 4}
model:
  name: mechanism
  bodies:
    upper: {mass: 0.5, inertia: 2.0e-3, position: [0, 0.1575]}
    lower: {mass: 0.5, inertia: 2.0e-3, position: [0, -0.1575]}
  joints:
    hinge: {type: revolute, bodies: [upper, lower], at: [0, 0]}
  markers:
    tip: {body: lower, point: [0, -0.1]}
  states:
    s: {initial: 0.5, rate: hinge.angle - states.s}
  forces:
    motor: {type: torque, body: lower, reaction_body: upper, value: k*states.s - 2*joints.hinge.angle + 0*markers.tip.x}
    cable: {type: law, law: one-sided, acts: tension, stiffness: 3.0, pathway: {type: joint-angles, angles: {hinge: 1}}}
    alike: {type: torque, body: lower, reaction_body: upper, value: k*states.s - 2*(lower.angle - upper.angle)}
""")
    given = spec({"brace": device({})})
    del given["model"]["devices"]["brace"]["mechanism"]
    given["model"]["devices"]["brace"]["file"] = "brace.yaml"
    (tmp_path / "worn.json").write_text(__import__("json").dumps(given))
    loaded = load_spec(tmp_path / "worn.json")
    m = loaded.mechanism()
    assert [name for name in m.bodies if "brace" in name] == ["brace.upper", "brace.lower"]
    assert m.forces["brace.cable"].pathway.radii == {"brace.hinge": 1.0}
    run = mbdkit.run(loaded)
    assert run.states["brace.s"].value[0] == 0.5
    assert run.forces["brace.motor"].value == pytest.approx(run.forces["brace.alike"].value, abs=1e-12)
    assert run.forces["brace.motor"].value[0] == pytest.approx(2.0 - 2.0 * run.joints["brace.hinge"].angle[0])
    assert mbdkit.run(loaded.sections()).data_sha256 == run.data_sha256  # the file is not needed again


def test_a_link_may_be_named_like_the_time_and_a_state_like_a_unit() -> None:
    links = {name: {"mass": 0.5, "inertia": 2e-3, "position": [0, y]} for name, y in (("s", 0.1575), ("t", -0.1575))}
    joints = {"hinge": {"type": "revolute", "bodies": ["s", "t"], "at": [0, 0]}}
    own: dict[str, Any] = {"name": "mechanism", "bodies": links, "joints": joints}
    own["states"] = {"m": {"rate": "t + t.angle + 0*s.vx", "unit": "m"}}
    own["coordinates"] = {"bend": "hinge.angle", "c": {"of": "t.angle", "relative_to": "s"}}
    own["forces"] = {"push": {"type": "torque", "body": "t", "value": "sin(10*t)*states.m"}}
    attach = {"s": device({})["attach"]["upper"], "t": device({})["attach"]["lower"]}
    worn = load_spec(spec({"d": device(own) | {"attach": attach}})).mechanism()
    assert worn.states["d.m"].rate == 't + bodies["d.t"].angle + 0*bodies["d.s"].vx'
    assert worn.states["d.m"].unit == "m"
    assert worn.forces["d.push"].value == 'sin(10*t)*states["d.m"]'
    assert worn.coordinates["d.bend"].of == "d.hinge.angle"
    assert worn.coordinates["d.c"].relative_to == "d.s"


def test_a_mechanism_in_python_wears_the_same_device() -> None:
    given = spec({"d": device(centred(), offset=[0.01, 0.0, 0.05])})
    other = load_spec(given).mechanism()
    own = mbdkit.Mechanism.from_spec(centred())
    del given["model"]["devices"]
    person = load_spec(given).mechanism()
    person.wear("d", own, attach=device({})["attach"], offset=("10 mm", 0.0, 0.05))
    assert person.to_spec() == other.to_spec()


@pytest.mark.parametrize(
    ("offset", "key", "sentence"),
    [
        ((0.0, 0.0, "35 mm"), "offset[2]", "'35 mm' has the unit mm, but this is a number in rad"),
        (("2 deg", 0.0, 0.0), "offset[0]", "'2 deg' has the unit deg, but this is a number in m"),
        ((1.0, 2.0), "offset[2]", "is missing"),
    ],
)
def test_a_wrong_offset_is_refused_in_python_as_in_a_spec(offset: tuple[Any, ...], key: str, sentence: str) -> None:
    person = load_spec(spec({})).mechanism()
    with pytest.raises(mbdkit.SpecError) as caught:
        person.wear("d", mbdkit.Mechanism.from_spec(centred()), attach=device({})["attach"], offset=offset)
    assert (caught.value.key, caught.value.message) == (f"devices.d.{key}", sentence)
    with pytest.raises(mbdkit.SpecError) as caught:
        load_spec(spec({"d": device(centred(), offset=[*offset])}))
    assert (caught.value.key, caught.value.message) == (f"model.devices.d.{key}", sentence)


@pytest.mark.parametrize(
    ("change", "key", "sentence"),
    [
        ({"attach": {"upper": {"limb": "thight", "at": [0, 0], "cuff": CUFF}}}, "attach.upper.limb",
         "there is no limb 'thight' for the cuff of 'upper' (did you mean 'thigh'?)"),
        ({"attach": {"upper": {"at": [0, 0], "cuff": CUFF}}}, "attach.upper.limb", "is missing"),
        ({"attach": {"uper": {"limb": "thigh", "at": [0, 0], "cuff": CUFF}}}, "attach.uper",
         "the device has no link 'uper' (did you mean 'upper'?)"),
        ({"attach": {}}, "attach", "is empty: attach at least one link of the device to a limb"),
        ({"offset": [0.0, 0.6, 0.0]}, "offset", "moves the cuff of 'upper' by 0.6 m, to 0.514 m from the"),
        ({"mechanism": {"name": "hinge-orthosi"}}, "mechanism.name", "did you mean 'hinge-orthosis'?"),
        ({"mechanism": {"name": "mechanism", "bodies": {"upper": {"mass": 1}, "lower": {"mass": 1}}, "joints": {
            "a": {"type": "distance", "bodies": ["upper", "lower"], "points": [[0, 0], [0, 0]], "length": 0.1},
            "b": {"type": "distance", "bodies": ["upper", "lower"], "points": [[0, 0], [0, 0]], "length": 0.2}}}},
         "mechanism.joints", "these joints cannot be assembled"),
        ({"mechanism": {"name": "mechanism", "bodies": {one: {"mass": 1, "inertia": 1} for one in ("upper", "lower")},
            "joints": {"a": {"type": "revolute", "bodies": ["ground", "upper"], "at": [0, 0]}}}},
         "mechanism.joints.a.bodies", "joins the device to the ground, but a worn device moves with the person"),
    ],
)  # fmt: skip
def test_wrong_devices_are_refused_in_a_sentence_with_the_key(change: dict[str, Any], key: str, sentence: str) -> None:
    with pytest.raises(mbdkit.SpecError) as caught:
        load_spec(spec({"d": device({"name": "hinge-orthosis", "height": H}) | change}))
    assert caught.value.key == f"model.devices.d.{key}"
    assert sentence in caught.value.message
    assert "\n" not in caught.value.message


def test_a_strut_pushes_thigh_and_shank_apart_along_its_line() -> None:
    # expected: the law of a spring between points `depth` behind the leg, at the distances of the cuffs from the knee
    own = {"name": "passive-strut", "height": H, "depth": 0.05, "stiffness": 800.0}
    rest = mbdkit.equilibrium(spec({"d": device(own)}, 0.9))
    torques = dict(zip(rest.joints, rest.reaction_torque.tolist(), strict=True))
    run = mbdkit.run(spec({"d": device(own)}, 0.9))
    upper, lower = (run[f"d.{link}"] for link in ("upper", "lower"))
    ends = []
    for link in (upper, lower):
        angle = link.angle[0]
        ends.append(link.position[0] - 0.05 * np.array([np.cos(angle), np.sin(angle)]))
    assert run.forces["d.strut"].value[0] == pytest.approx(800.0 * (np.linalg.norm(ends[1] - ends[0]) - 2.0 * ARM))
    assert run.forces["d.strut"].value[0] < -10.0
    assert torques["knee_motor"] < -1.0  # the driver bends the knee against the strut


def test_an_exoskeleton_of_hip_and_knee_carries_torques_to_both_joints() -> None:
    own = {"name": "hip-knee-exoskeleton", "height": H, "motor": 0.01, "hip_motor": 0.02}
    section = device(own)
    section["attach"]["pelvis"] = {"limb": "ground", "at": [0.0, 0.1], "cuff": CUFF}
    rest = mbdkit.equilibrium(spec({"d": section}, 0.4))
    torques = dict(zip(rest.joints, rest.reaction_torque.tolist(), strict=True))
    assert torques["knee_motor"] == pytest.approx(-0.01, rel=2e-3)
    assert torques["hip_motor"] == pytest.approx(-0.02, rel=2e-3)


def legs(trunk: str | None) -> mbdkit.Mechanism:
    """Return two legs on a trunk, on a pelvis below a heavier trunk with an arm, or on hips that the ground fixes."""
    m = mbdkit.Mechanism()
    hip = trunk or m.ground
    if trunk is not None:
        m.body("trunk", mass=40.0, inertia=3.0)
    if trunk == "pelvis":
        m.body("pelvis", mass=10.0, inertia=0.1)
        m.revolute("lumbar", "trunk", "pelvis", at=(0.0, 0.0))
        for name, above in {"arm": "trunk", "forearm": "arm"}.items():
            m.body(name, mass=2.0, inertia=0.02)
            m.revolute(name, above, name, at=(0.0, 0.0))
    for side in ("right", "left"):
        for name, above in {"thigh": hip, "shank": f"thigh_{side}", "foot": f"shank_{side}"}.items():
            m.body(f"{name}_{side}", mass=3.0, inertia=0.05)
            m.revolute(f"{name}_{side}", above, f"{name}_{side}", at=(0.0, 0.0))
    return m


@pytest.mark.parametrize("trunk", ["trunk", "pelvis", None])
def test_a_device_on_two_legs_is_refused_unless_it_is_on_the_trunk_or_meant_to_join_them(trunk: str | None) -> None:
    def wear(*limbs: str, **keys: object) -> None:
        device = mbdkit.Mechanism()
        attach = {}
        for number, limb in enumerate(limbs):
            device.body(f"link{number}", mass=0.5, inertia=0.01)
            attach[f"link{number}"] = {"limb": limb, "at": (0.0, 0.0), "cuff": CUFF}
        legs(trunk).wear("brace", device, attach=attach, **keys)

    for pair in (("thigh_right", "shank_left"), ("foot_left", "foot_right")):
        with pytest.raises(mbdkit.SpecError, match="two limbs") as caught:
            wear(*pair)
        assert all(f"is on '{limb}'" in caught.value.message for limb in pair)
        assert "`joins_limbs: true`" in caught.value.message
        assert caught.value.key.startswith("devices.brace.attach.")
        wear(*pair, joins_limbs=True)
    for several in (("thigh_right", "shank_right"), ("thigh_left", "foot_left"), ("shank_left",)):
        wear(*several)
    if trunk is not None:
        wear(trunk, "thigh_right", "thigh_left")
        wear("trunk", "thigh_left", "shank_left")
