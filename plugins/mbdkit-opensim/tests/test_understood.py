"""What an OpenSim file contains is read, has no effect, or is named. Expected values are those of OpenSim 4.6."""

from __future__ import annotations

from pathlib import Path

import osim_texts as osim
import pytest

import mbdkit
from mbdkit import Mechanism, SpecError
from mbdkit_opensim.building import build_mechanism
from mbdkit_opensim.understood import IDLE, IGNORED, INERT, READ, defaults_of, registry

ROD = [osim.body("rod", 2.0, (0.3, 0.0, 0.0), 0.06)]
PIN = osim.joint("PinJoint", "pin", "ground", "rod", "turn=0.3")
SPRING = '<SpringGeneralizedForce name="s"><coordinate>turn</coordinate>{}</SpringGeneralizedForce>'
PATH = (
    "<path><GeometryPath><PathPointSet><objects>"
    '<PathPoint name="a"><socket_parent_frame>/ground</socket_parent_frame><location>0 1 0</location></PathPoint>'
    '<PathPoint name="b"><socket_parent_frame>/bodyset/rod</socket_parent_frame><location>0.2 0 0</location>'
    "</PathPoint>"
    "</objects></PathPointSet></GeometryPath></path>"
)


def built(tmp_path: Path, text: str, *, muscles: bool = False) -> Mechanism:
    (tmp_path / "model.osim").write_text(text, encoding="utf-8")
    return build_mechanism(str(tmp_path / "model.osim"), {}, {}, muscles=muscles)


def group(tag: str, inner: str) -> str:
    return f"<{tag}><objects>{inner}</objects></{tag}>"


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (group("ForceSet", SPRING.format("")), "SpringGeneralizedForce"),
        (f"<components>{SPRING.format('')}</components>", "SpringGeneralizedForce in Model"),
        (group("ComponentSet", SPRING.format("")), "SpringGeneralizedForce in Model"),
        (group("ForceSet", '<DiscreteForces name="s"/>'), "DiscreteForces"),
        (group("ForceSet", '<NewForce name="s"/>'), "NewForce"),  # a type of a later version
        # since format 3.5.08, `isDisabled` has no effect
        (group("ForceSet", SPRING.format("<isDisabled>true</isDisabled>")), "SpringGeneralizedForce"),
        ("<new_property>1</new_property>", "<new_property> of Model"),
    ],
)
def test_a_component_or_property_that_is_not_understood_is_named(tmp_path: Path, more: str, named: str) -> None:
    (sentence,) = built(tmp_path, osim.document(ROD, [PIN], more=more)).left_out
    assert f"has 1 {named}, which the mechanism leaves out" in sentence


def test_a_force_in_the_components_of_a_body_is_named(tmp_path: Path) -> None:
    body = ROD[0].replace("</Body>", f"<components>{SPRING.format('')}</components></Body>")
    assert "SpringGeneralizedForce in Body" in built(tmp_path, osim.document([body], [PIN])).left_out[0]


@pytest.mark.parametrize(
    "more",
    [
        group("ForceSet", SPRING.format("<appliesForce>0</appliesForce>")),
        group("ForceSet", '<CoordinateActuator name="motor"/>'),
        group("ProbeSet", '<SystemEnergyProbe name="energy"/>'),
        group("ContactGeometrySet", '<ContactSphere name="heel"><radius>0.1</radius></ContactSphere>'),
        "<credits>somebody</credits><ModelVisualPreferences><ModelDisplayHints/></ModelVisualPreferences>",
        f"<components>{osim.offset('f', '/ground', (0, 0, 0), (0, 0, 0))}</components>",
    ],
)
def test_what_has_no_effect_raises_no_doubt(tmp_path: Path, more: str) -> None:
    m = built(tmp_path, osim.document(ROD, [PIN], more=more))
    assert not m.left_out
    assert not m.left_out_of_runs


@pytest.mark.parametrize(
    "acting",
    ['<ActivationCoordinateActuator name="a"/>', '<RigidTendonMuscle name="a"/>', '<Thelen2003Muscle name="a"/>'],
)
def test_actuators_that_act_without_control_question_runs_but_not_inverse_dynamics(tmp_path: Path, acting: str) -> None:
    m = built(tmp_path, osim.document(ROD, [PIN], more=group("ForceSet", acting)))
    assert not m.left_out
    assert "which the mechanism leaves out: a" in m.left_out_of_runs[0]
    zero = {"column": "a", "rate": "a", "acceleration": "a"}
    motion = {"data": {"time": [0.0, 0.1, 0.2, 0.3, 0.4], "a": [0.0] * 5}, "columns": {"turn": zero}}
    model = {"name": "opensim", "file": str(tmp_path / "model.osim")}
    run = mbdkit.inverse({"mbdkit": 1, "model": model, "motion": motion})
    assert any("leaves out: a" in warning for warning in run.warnings)
    assert not any(reason.startswith("left-out") for reason in run.verdict_reasons)


def test_a_controller_questions_runs(tmp_path: Path) -> None:
    controller = group("ControllerSet", '<PrescribedController name="c"/>')
    assert "PrescribedController" in built(tmp_path, osim.document(ROD, [PIN], more=controller)).left_out_of_runs[0]


def test_unread_properties_of_muscles_are_named_and_absent_ones_have_the_defaults_of_opensim(tmp_path: Path) -> None:
    curves = "<ActiveForceLengthCurve><minimum_value>0</minimum_value></ActiveForceLengthCurve>"
    muscles = (
        f'<Millard2012EquilibriumMuscle name="as_read">{PATH}{curves}</Millard2012EquilibriumMuscle>'
        f'<Millard2012EquilibriumMuscle name="limited">{PATH}<max_control>0.5</max_control>'
        "</Millard2012EquilibriumMuscle>"
        f'<DeGrooteFregly2016Muscle name="smooth">{PATH}</DeGrooteFregly2016Muscle>'
        f'<Thelen2003Muscle name="thelen">{PATH}</Thelen2003Muscle>'
    )
    m = built(tmp_path, osim.document(ROD, [PIN], more=group("ForceSet", muscles)), muscles=True)
    assert any(" <max_control> of Millard2012EquilibriumMuscle" in sentence for sentence in m.left_out)
    assert any("curves of Thelen2003Muscle are replaced" in sentence for sentence in m.left_out)
    assert len(m.left_out) == 2
    assert m.muscles["smooth"].activation.initial == 0.5
    assert (m.muscles["thelen"].activation.rise, m.muscles["thelen"].activation.fall) == (0.015, 0.05)


@pytest.mark.parametrize("locked", ["1", "True", " true "])
def test_all_spellings_of_true_lock_a_coordinate(tmp_path: Path, locked: str) -> None:
    m = built(tmp_path, osim.document(ROD, [PIN.replace("<locked>0", f"<locked>{locked}")]))
    assert not m.coordinates


def test_frames_with_equal_names_are_told_apart_by_their_paths(tmp_path: Path) -> None:
    bodies = [*ROD, osim.body("tip", 1.0, (0.1, 0.0, 0.0), 0.01)]
    first = osim.joint("PinJoint", "pin", "ground", "rod", "turn", at=(1.0, 2.0, 0.0))
    second = osim.joint("PinJoint", "end", "ground", "tip", "bend", at=(5.0, 0.0, 0.0)).replace(
        "<socket_parent_frame>ground_offset", "<socket_parent_frame>/jointset/pin/ground_offset"
    )
    m = built(tmp_path, osim.document(bodies, [first, second]))
    assert m.bodies["tip"].position == pytest.approx((1.1, 2.0))
    unclear = second.replace("/jointset/pin/ground_offset", "/elsewhere/ground_offset")
    with pytest.raises(SpecError, match="may be /jointset/pin/ground_offset or /jointset/end/ground_offset"):
        built(tmp_path, osim.document(bodies, [first, unclear]))


def test_defaults_of_the_file_apply_to_absent_properties(tmp_path: Path) -> None:
    defaults = '<defaults><Coordinate name="default"><default_value>0.7</default_value></Coordinate></defaults>'
    given = PIN.replace("<default_value>0.3</default_value>", "")
    m = built(tmp_path, osim.document(ROD, [given], more=defaults))
    assert m.bodies["rod"].angle == 0.7


def test_contact_parameters_with_colons_in_their_name_are_read(tmp_path: Path) -> None:
    force = (
        '<HuntCrossleyForce name="heel"><HuntCrossleyForce::ContactParametersSet name="p"><objects>'
        "<HuntCrossleyForce::ContactParameters/></objects></HuntCrossleyForce::ContactParametersSet></HuntCrossleyForce>"
    )
    m = built(tmp_path, osim.document(ROD, [PIN], more=group("ForceSet", force)))
    assert "HuntCrossleyForce" in m.left_out[0]


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("model.osim", '<?xml version="1.0" encoding="no-such"?><OpenSimDocument/>', "an encoding that does not exist"),
        ("~nosuchuser/model.osim", "", "~nosuchuser/model.osim: "),
        ("model.osim", osim.document(ROD, [PIN.replace("<locked>0", "<locked>yes")]), "true or false, not 'yes'"),
        ("model.osim", osim.document(ROD, [PIN]).replace("<mass>2.0", "<mass>1_0"), "a finite number, not '1_0'"),
        ("model.osim", osim.document(ROD * 2, [PIN]), "two components are called Body 'rod'"),
    ],
)
def test_mistakes_in_a_file_are_the_users(tmp_path: Path, file: str, content: str, message: str) -> None:
    (tmp_path / "model.osim").write_text(content, encoding="utf-8")
    model = {"name": "opensim", "file": file if file.startswith("~") else str(tmp_path / file)}
    with pytest.raises(SpecError) as error:
        mbdkit.run({"mbdkit": 1, "model": model, "integrator": {"name": "rk4"}, "time": {"end": 1.0, "step": 0.1}})
    assert error.value.key == "model.file"
    assert message in str(error.value)


def test_the_lists_name_types_and_properties_of_the_registry() -> None:
    # printed by tests.benchmarks.registry_of_opensim: OpenSim does not know names of OpenSim 3
    types = {kind for of in registry().values() for kind in of}
    assert types >= IDLE | INERT
    assert types >= {*READ, *IGNORED} - {"", "NaturalCubicSpline"}
    assert set(registry()["Actuator"]) >= IDLE
    forces = {kind for base in ("Force", "Muscle", "Controller", "Constraint") for kind in registry()[base]}
    assert not forces & (IDLE | INERT)
    older = {"motion_type", "defaults"}
    for kind, properties in IGNORED.items():
        assert not kind or set(defaults_of(kind)) | older >= properties
