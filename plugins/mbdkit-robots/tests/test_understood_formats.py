"""What the readers of MJCF and URDF do not understand makes the result doubtful by name, or is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbdkit

pytest.importorskip("defusedxml")
import mbdkit_robots

ROD = '<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/>'
PENDULUM = f"""<mujoco>TOP
<option gravity="0 0 -9.81"><flag contact="disable"/></option>
<worldbody><body name="b" POSE><joint name="j" axis="0 1 0" JOINT/>{ROD}INNER</body></worldbody>END</mujoco>"""
FREE = """<mujoco><worldbody><body name="b"><freejoint/><geom type="box" size=".1 .1 .2" mass="1"/>
<body name="c" pos=".1 HEIGHT 0"><joint name="j" axis="0 1 0"/><geom type="box" size=".1 .1 .2" EULER/></body>
</body></worldbody></mujoco>"""
URDF = Path(mbdkit_robots.__file__).with_name("arm.urdf").read_text()


def pendulum(**parts: str) -> str:
    """Return the file of a pendulum with parts inserted."""
    text = PENDULUM
    for part in ("TOP", "POSE", "JOINT", "INNER", "END"):
        text = text.replace(part, parts.get(part.lower(), ""))
    return text


def spec(path: Path, text: str, kind: str = "mjcf") -> mbdkit.RunSpec:
    """Return the spec of a file with some text, with the joint `j` at 0.6 rad and 1 rad/s if it has one."""
    path.write_text(text)
    initial = {"initial": {"j": 0.6}, "speeds": {"j": 1.0}} if 'name="j"' in text else {}
    model = {"name": kind, "file": str(path), **initial}
    return mbdkit.RunSpec(mbdkit=1, model=model, integrator={"name": "gauss", "stages": 3},
                          time={"end": 0.25, "step": 0.005})  # fmt: skip


LOWER = f'<body name="c" pos="0 0 -.5"><joint name="k" axis="0 1 0"/>{ROD}</body>'
BOX = """<mujoco><default><geom type="box" size=".1 .2 .3"/></default>
<worldbody><body name="b"><joint name="j" axis="0 1 0"/>"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            pendulum(
                top='<default><equality active="false"/></default>', inner=LOWER,
                end='<equality><weld body1="b" body2="c"/></equality>',
            ),
            [-0.11151796, -0.22374929],
        ),
        (BOX + '<geom size=".1" pos=".2 0 -.2"/></body></worldbody></mujoco>', [-0.03667139, -0.28045536]),
        (
            pendulum(top='<compiler autolimits="true"/><compiler angle="radian"/>', pose='euler="0 .5 0"'),
            [-0.13883382, -0.20790664],
        ),
        (
            pendulum(
                top='<default><joint damping="0.5" stiffness="10"/></default><default><geom rgba="1 0 0 1"/></default>'
            ),
            [0.06306716, -0.24191431],
        ),
        (pendulum(end='<option gravity="0 0 -3"/>'), [-0.15831676, -0.19348334]),
    ],
    ids=["inactive-equality", "inherited-sizes", "two-compilers", "two-defaults", "two-options"],
)  # fmt: skip
def test_sections_and_defaults_are_merged_as_in_mujoco(tmp_path: Path, text: str, expected: list[float]) -> None:
    """The expected positions of the centre of mass after 0.25 s were printed by MuJoCo 4.0.0 (RK4, steps of 0.2 ms)."""
    run = mbdkit.run(spec(tmp_path / "model.xml", text))
    np.testing.assert_allclose(run["b"].position[-1], expected, atol=2e-8)
    assert not spec(tmp_path / "model.xml", text).mechanism().left_out


def motor(attributes: str, tag: str = "motor") -> str:
    return pendulum(end=f'<actuator><{tag} joint="j" {attributes}/></actuator>')


ACTS = "actuators that act without control"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (motor('armature=".5"'), "armature of actuators"),
        (motor('damping="2"'), "damping of actuators"),
        (motor('ctrlrange="1 2"'), ACTS),
        (motor('forcerange="1 2" forcelimited="true"'), ACTS),
        (motor('dyntype="user"', "general"), ACTS),
        (motor("").replace("<option", '<default><motor ctrlrange=".5 1"/></default><option'), ACTS),
        (motor("", "general").replace("<option", '<default><position kp="20"/></default><option'), ACTS),
        (pendulum(joint='actuatorfrcrange="1 2"'), ACTS),
        (pendulum(joint='springyield="0.1"'), "springyield of <joint>"),
        (pendulum(joint='stiffness="1 2"'), "the nonlinear part of the stiffness of joints"),
        (pendulum(top='<option><flag sleep="enable"/></option>'), "sleep of <flag>"),
        (pendulum(inner='<plugin plugin="mujoco.x"/>'), "elements <plugin>"),
        (pendulum(joint='news="1"'), "news of <joint>"),
        (pendulum(end="<news/>"), "elements <news>"),
        (pendulum(inner=LOWER.replace("</body>", LOWER.replace('"c"', '"d"').replace('"k"', '"l"') + "</body>"))
         .replace('<flag contact="disable"/>', ""), "contacts between moving bodies"),
        (FREE.replace("HEIGHT", "0.2").replace("EULER", ""), "motions of free bodies out of the plane"),
        (FREE.replace("HEIGHT", "0").replace("EULER", 'euler="30 0 0"'), "motions of free bodies out of the plane"),
        (FREE.replace("HEIGHT", "0").replace("EULER", "").replace("<world", '<option gravity="0 1 0"/><world'),
         "motions of free bodies out of the plane"),
    ],
)  # fmt: skip
def test_what_mjcf_has_and_mbdkit_does_not_understand_is_a_doubt_by_name(tmp_path: Path, text: str, kind: str) -> None:
    left_out = spec(tmp_path / "model.xml", text).mechanism().left_out
    assert len(left_out) == 1
    assert left_out[0].startswith(f"{kind} left out, which may change the motion: ")


@pytest.mark.parametrize(
    "text",
    [
        motor('ctrlrange="-1 2" forcerange="0 1" armature="0" group="2"'),
        motor("").replace("<option", '<default><position kp="20"/></default><option'),  # <motor> resets the law
        motor('gainprm="3" dyntype="filter" dynprm="0.1"', "general"),
        motor('actuatorfrcrange="1 2"').replace('actuatorfrcrange="1 2"', ""),
        pendulum(joint='margin="0" springyield="0" solreflimit="0.1 1" group="3"'),
        pendulum(top='<size njmax="100"/><visual><map znear="0.1"/></visual><statistic extent="1"/>'),
        pendulum(inner='<camera name="eye"/><light/><site name="s"/>'),
        FREE.replace("HEIGHT", "0").replace("EULER", ""),
    ],
)
def test_what_cannot_change_a_motion_is_no_doubt(tmp_path: Path, text: str) -> None:
    assert spec(tmp_path / "model.xml", text).mechanism().left_out == ()


def geom(attributes: str) -> str:
    return pendulum().replace(ROD, f"<geom {attributes}/>")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (geom('type="box" size=".1 .1 .3" mass="1" shellinertia="true"'), "shellinertia, which is not computed"),
        (geom('type="box" size=".1"'), "type 'box', which needs 3 positive sizes"),
        (geom('type="sphere" size="0"'), "type 'sphere', which needs 1 positive sizes"),
        (geom('type="box" size=".1 .1 .1" density="-1"'), "a geom with a negative density"),
        (geom('size=".1" class="nowhere"'), "has the class 'nowhere', for which there is no <default>"),
        (geom('size=".1" quat="1 0 0 0" euler="0 0 0"'), "several orientations: quat, euler"),
        (pendulum(top='<default class="other"/>'), "which should be 'main'"),
        (pendulum(top='<compiler eulerseq="xyw"/>'), "should have three of the letters"),
        (pendulum(top='<compiler angle="grad"/>'), "should be degree or radian"),
        (pendulum(top='<compiler inertiafromgeom="false"/>'), "no <inertial>, although inertiafromgeom is false"),
        (pendulum(end='<equality><weld body1="b" torquescale="0"/></equality>'), "a torquescale of 0"),
    ],
)
def test_what_would_be_misread_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(mbdkit.SpecError, match=message):
        spec(tmp_path / "model.xml", text).mechanism()


def test_a_box_between_two_points_has_the_mass_of_its_volume(tmp_path: Path) -> None:
    """A box of 1 m with the half widths 0.1 m has 0.04 m^3, and the moment m (1 + 0.04) / 12 about its centre."""
    body = spec(tmp_path / "model.xml", geom('type="box" size=".1" fromto="0 0 0 1 0 0"')).mechanism().bodies["b"]
    assert (body.mass, body.inertia) == pytest.approx((40.0, 40 * 1.04 / 12))
    assert body.position == pytest.approx((0.5 * np.cos(0.6), -0.5 * np.sin(0.6)))


def test_bodies_of_all_worldbody_sections_and_constraints_with_names_of_joints_are_read(tmp_path: Path) -> None:
    second = '<worldbody><body name="c" pos="0 0 1"><joint name="k" axis="0 1 0"/>' + ROD + "</body></worldbody>"
    closing = '<equality><connect name="k" body1="b" body2="c" anchor="0 0 -.5"/><connect body1="b" body2="c" '
    m = spec(tmp_path / "model.xml", pendulum(end=second + closing + 'anchor="0 0 0"/></equality>')).mechanism()
    assert list(m.bodies) == ["b", "c"]
    assert list(m.joints) == ["j", "k", "k'", "b to c"]


@pytest.mark.parametrize(
    ("before", "after", "kind"),
    [
        ('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 0"/><safety_controller k_velocity="1"/>', "elements <safety_contr"),
        ('<origin xyz="0 0 1"/>', '<origin xyz="0 0 1" quat_xyzw="0 1 0 0"/>', "quat_xyzw of <origin>"),
        ('damping="0.05"', 'damping="0.05" stiffness="2"', "stiffness of <dynamics>"),
        ("</robot>", "<mujoco><option/></mujoco></robot>", "elements <mujoco>"),
        ("</robot>", '<gazebo reference="a"><turnGravityOff/></gazebo></robot>', "extensions of Gazebo"),
        ('lower="-3" upper="3"', "", "limits without a range"),
        ('<link name="tip"/>', '<link name="tip"><collision/></link>', "contacts with fixed geoms"),
    ],
)
def test_what_urdf_has_and_mbdkit_does_not_understand_is_a_doubt_by_name(
    tmp_path: Path, before: str, after: str, kind: str
) -> None:
    assert before in URDF
    text = URDF.replace(before, after).replace('<link name="base"/>', '<link name="base"><collision/></link>')
    (left_out,) = spec(tmp_path / "arm.urdf", text, "urdf").mechanism().left_out
    assert left_out.startswith(kind)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('<link name="tip"/>', '<link name="tip"/><link name="tip"/>', "two links with the name 'tip'"),
        ('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><axis xyz="0 -1 0"/>', "several elements <axis>"),
        ('<parent link="base"/>', '<parent link="tip"/>', "some of them form a closed chain"),
    ],
)
def test_files_that_urdf_forbids_are_refused(tmp_path: Path, before: str, after: str, message: str) -> None:
    assert before in URDF
    with pytest.raises(mbdkit.SpecError, match=message):
        spec(tmp_path / "arm.urdf", URDF.replace(before, after), "urdf").mechanism()


def test_looks_and_transmissions_of_urdf_are_no_doubt(tmp_path: Path) -> None:
    more = "<material name='a'/><gazebo reference='tip'><material>A</material></gazebo><transmission name='t'/></robot>"
    text = URDF.replace("</robot>", more).replace('<link name="tip"/>', '<link name="tip"><visual/></link>')
    m = spec(tmp_path / "arm.urdf", text, "urdf").mechanism()
    assert m.left_out == ()
    assert "transmissions left out: t" in m.warnings
