"""Contacts in specs and files of points: what is refused, and what comes back from `to_spec`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.spec import RunSpec, load_spec
from mbdkit_contact.quantities import contact_names

FLOOR: dict[str, Any] = {"line": {"normal": [0.0, 1.0]}}
BALL: dict[str, Any] = {"circle": {"radius": 0.1}}


def spec(contact: dict[str, Any], **more: Any) -> dict[str, Any]:
    own = {"bodies": ["ground", "b"], "shapes": [FLOOR, BALL], "compliance": {"stiffness": 1e5}, **contact}
    own = {key: value for key, value in own.items() if value is not None}
    bodies = {"b": {"mass": 1.0, "inertia": 0.1, "position": [0.0, 0.5]}, "c": {"mass": 1.0, "inertia": 0.1}}
    pin = {"type": "revolute", "bodies": ["b", "c"], "at": [0.0, 0.2]}
    return {
        "mbdkit": 1, "model": {"name": "mechanism", "bodies": bodies, "joints": {"pin": pin}, "contacts": {"k": own}},
        "integrator": {"name": "rk4"}, "time": {"end": 0.001, "step": 0.001}, **more,
    }  # fmt: skip


K = "model.contacts.k"
CLOCKWISE, CONCAVE = [[0, 0], [0, 1], [1, 0]], [[0, 0], [1, 0], [0.2, 0.2], [0, 1]]
SAME = [[0, 0], [1, 0], [1, 0], [0, 1]]
REFUSED = {
    "restitution": ({"restitution": 1.2}, "model.contacts.k.restitution", "at most 1"),
    "friction": ({"friction": -0.1}, "model.contacts.k.friction", "at least 0"),
    "order of friction": ({"friction": {"static": 0.2, "kinetic": 0.3}}, "model.contacts.k.friction.kinetic", "static"),
    "stiffness": ({"compliance": {"stiffness": -1.0}}, "model.contacts.k.compliance.stiffness", "greater than 0"),
    "text": ({"compliance": {"stiffness": "1 MN"}}, "model.contacts.k.compliance.stiffness", "number"),
    "unknown body": ({"bodies": ["ground", "bb"]}, "model.contacts.k.bodies[1]", "there is no body 'bb'"),
    "held by a joint": ({"bodies": ["b", "c"], "shapes": [BALL, BALL]}, "model.contacts.k.bodies", "joint 'pin' holds"),
    "two lines": ({"shapes": [FLOOR, FLOOR]}, "model.contacts.k.shapes", "two lines"),
    "two points": ({"shapes": [{"point": [0, 0]}, {"point": [0, 0]}]}, "model.contacts.k.shapes", "two points"),
    "too large": (
        {"shapes": [{"hole": {"radius": 0.1}}, BALL]}, f"{K}.shapes", "less than the radius of the hole, 0.1",
    ),
    "no hole for lines": ({"shapes": [FLOOR, {"hole": {"radius": 0.1}}]}, "model.contacts.k.shapes", "not a line"),
    "radius of a hole": ({"shapes": [{"hole": {"radius": -1}}, BALL]}, "model.contacts.k.shapes[0].hole.radius", "0"),
    "clockwise": ({"shapes": [FLOOR, {"polygon": CLOCKWISE}]}, f"{K}.shapes[1].polygon", "counter-clockwise"),
    "concave": ({"shapes": [FLOOR, {"polygon": CONCAVE}]}, f"{K}.shapes[1].polygon", "convex"),
    "corners that coincide": (
        {"shapes": [FLOOR, {"polygon": SAME}]}, f"{K}.shapes[1].polygon", "no three are on a line",
    ),
    "overlap": ({"shapes": [FLOOR, {"circle": {"radius": 0.7}}]}, "model.contacts.k.shapes", "overlap by 0.2 m"),
    "no compliance": ({"compliance": None}, "model.contacts.k.compliance", "is missing"),
    "flores": ({"compliance": {"law": "flores", "stiffness": 1.0}}, f"{K}.compliance.impact_speed", "needs"),
    "no shape": (
        {"shapes": [FLOOR, {}]}, "model.contacts.k.shapes[1]", "one of line, polyline, point, circle, hole and polygon",
    ),
    "one point": ({"shapes": [{"polyline": [[0, 0]]}, BALL]}, f"{K}.shapes[0].polyline", "at least two points"),
    "repeated point": ({"shapes": [{"polyline": SAME[:3]}, BALL]}, f"{K}.shapes[0].polyline[2]", "repeats"),
    "leftwards": ({"shapes": [{"polyline": [[0, 0], [1, 0], [0.5, 1]]}, BALL]}, f"{K}.shapes[0].polyline[2]", "decr"),
    "turns back": ({"shapes": [{"polyline": [[0, 0], [0, 2], [0, 1]]}, BALL]}, f"{K}.shapes[0].polyline[1]", "back"),
    "polyline and line": ({"shapes": [FLOOR, {"polyline": [[0, 0], [1, 0]]}]}, f"{K}.shapes", "two lines"),
    "among": ({"bodies": None, "among": ["b", "c"]}, "model.contacts.k.shapes", "mapping"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_bad_contacts_are_refused_with_the_key(name: str) -> None:
    contact, key, words = REFUSED[name]
    with pytest.raises(SpecError) as caught:
        mbdkit.run(spec(contact))
    assert caught.value.key == key
    assert words in caught.value.message


def test_a_joint_with_clearance_is_referred_to_contacts() -> None:
    given = spec({})
    given["model"]["joints"]["pin"]["clearance"] = 5e-4
    with pytest.raises(SpecError, match="a pin with clearance is a contact in place of the joint"):
        load_spec(given)


def test_both_coefficients_of_friction_may_be_expressions() -> None:
    contact = {"friction": {"static": "2*mu", "kinetic": "mu"}, "compliance": {"stiffness": 1e5}}
    assert load_spec(spec(contact, parameters={"mu": 0.2})).mechanism().contacts["k"].friction_coefficients == (
        0.4,
        0.2,
    )


def test_contacts_come_back_from_to_spec_and_numbers_may_be_expressions() -> None:
    contact = {"friction": "2*mu", "compliance": {"stiffness": "k"}}
    given = load_spec(spec(contact, parameters={"mu": 0.2, "k": 1e5})).mechanism()
    assert given.contacts["k"].friction_coefficients == (0.4, 0.4)
    model = given.to_spec()
    assert Mechanism.from_spec(model).to_spec() == model


def test_bodies_that_touch_each_other_have_a_contact_for_each_pair_without_a_joint() -> None:
    contact = {"bodies": None, "among": ["b", "c", "ground"], "shapes": {"b": BALL, "c": BALL, "ground": FLOOR}}
    assert contact_names(load_spec(spec(contact)).mechanism()) == ["k.b.ground", "k.c.ground"]


SPEC = """
mbdkit: 1
model:
  name: mechanism
  bodies: {ball: {mass: 1.0, inertia: 0.004, position: [0.0, 0.2]}}
  contacts:
    floor:
      bodies: [ground, ball]
      shapes:
      - polyline: {file: ground.csv, y: height, unit: cm}
      - circle: {radius: 0.1}
      compliance: {stiffness: 1.0e+6}
time: {end: 0.02, step: 0.001}
integrator: {name: rk4}
"""
TABLE = "# a ramp\nx; height\n-100; 0\n50; 0\n100; 20\n"


@pytest.fixture
def spec_file(tmp_path: Path) -> Path:
    (tmp_path / "ground.csv").write_text(TABLE, encoding="utf-8")
    (tmp_path / "run.yaml").write_text(SPEC, encoding="utf-8")
    return tmp_path / "run.yaml"


def test_archives_have_the_points_of_a_file_and_its_name(spec_file: Path) -> None:
    done = mbdkit.run(spec_file)
    assert [file.name for file in done.files] == ["ground.csv"]
    done.save(spec_file.parent / "run.h5")
    (spec_file.parent / "ground.csv").unlink()
    with mbdkit.load(spec_file.parent / "run.h5") as stored:
        points = stored.mechanism.contacts["floor"].shapes[0].polyline
        np.testing.assert_allclose(points, [[-1.0, 0.0], [0.5, 0.0], [1.0, 0.2]], rtol=1e-15)
        again = mbdkit.run(stored.spec)
    np.testing.assert_array_equal(again["ball"].position, done["ball"].position)


@pytest.mark.parametrize(
    ("table", "line", "words"),
    [
        ("", None, "this file is empty"),
        ("x,y\n0,0\n", 1, "there should be one column 'height'; columns: x and y"),
        ("x,height\n0,0\n1,high\n", 3, "should have a number here"),
        ("x,height\n0,0\n\n1\n", 4, "this row has 1 cell, but there are 2 headings"),
        (None, None, "this file cannot be read"),
    ],
)
def test_bad_tables_are_refused_with_file_and_line(
    spec_file: Path, table: str | None, line: int | None, words: str
) -> None:
    path = spec_file.parent / "ground.csv"
    if table is None:
        path.unlink()
    else:
        path.write_text(table, encoding="utf-8")
    with pytest.raises(mbdkit.SpecError, match=words) as caught:
        load_spec(spec_file)
    assert (caught.value.file, caught.value.line) == (str(path), line)


@pytest.mark.parametrize(
    ("before", "after", "key", "words"),
    [
        ("unit: cm", "unit: kg", ".unit", "a unit of length"),
        ("unit: cm", "units: cm", ".units", "did you mean 'unit'"),
        ("-100", "100", "[1]", "x decreases"),
    ],
)
def test_bad_keys_and_points_are_refused_with_the_key(
    spec_file: Path, before: str, after: str, key: str, words: str
) -> None:
    for path in spec_file.parent.iterdir():
        path.write_text(path.read_text(encoding="utf-8").replace(before, after), encoding="utf-8")
    with pytest.raises(mbdkit.SpecError, match=words) as caught:
        load_spec(spec_file)
    assert caught.value.key == f"model.contacts.floor.shapes[0].polyline{key}"


def test_validated_data_open_no_file(spec_file: Path) -> None:
    """Archives are read in this way: a file that one of them names is not opened."""
    data = load_spec(spec_file).model_dump()
    data["model"]["contacts"]["floor"]["shapes"][0]["polyline"] = {"file": str(spec_file.parent / "ground.csv")}
    with pytest.raises(mbdkit.SpecError, match="files of points are read from spec files only"):
        RunSpec(**data)
