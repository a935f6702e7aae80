"""The first section of a report: the drawing with names, of laws and of archives too, and the tables of the model."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import mbdkit
from mbdkit import Mechanism
from mbdkit.archive.fingerprint import seal
from mbdkit.archive.stored_mechanism import mechanism_json, read_mechanism
from mbdkit.base.units import read_unit
from mbdkit.mechanism.beams import parts_of
from mbdkit.spec import example_names, load_spec
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import load_inverse_spec
from mbdkit_report import Drawing, Illustration, NamedPose, draw_mechanism, run_report
from mbdkit_report.figures.drawing_geometry import draw_run
from mbdkit_report.figures.label_placement import LINE, Name, place_names
from mbdkit_report.figures.mechanism_drawing import mechanism_svg, names_shown
from mbdkit_report.pages import model_section
from mbdkit_report.unit_of_use import unit_of_use
from tests.archive.stored import SHORT, stored, swing
from tests.laws.walker import SWEEP, walker
from tests.linkages import driven_wheel


def start(mechanism):
    """Return what to draw of a mechanism at its initial position."""
    pose = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    return NamedPose.of(mechanism, list(mechanism.bodies), pose, np.array([0.0, 1.0]))


def texts(svg):
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


@pytest.mark.parametrize(("rods", "are_shown"), [(25, True), (45, False)])
def test_a_drawing_of_many_links_has_no_names_and_says_so(rods: int, are_shown: bool) -> None:
    shown = start(load_spec("double-pendulum", model={"name": "n-pendulum", "n": rods}).mechanism())
    assert names_shown(shown) == are_shown
    assert ("J1" in texts(mechanism_svg(shown, Illustration.WIDE))) == are_shown


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (i % 3 > 0)) for i, name in enumerate(sorted(example_names("run")))],
)
def test_every_element_of_an_example_is_named_once(name):
    mechanism = load_spec(name).mechanism()
    shown = start(mechanism)
    if not names_shown(shown):
        return
    parts = parts_of(mechanism.beams)
    named = [*mechanism.bodies, *mechanism.joints, *mechanism.forces]
    named += [*mechanism.elements.get("muscles", ()), *mechanism.elements.get("cuffs", ())]
    named += [name for name in mechanism.markers if name not in mechanism.joints]
    named = [name for name in named if name not in parts] + list(mechanism.beams)
    for found in (texts(mechanism_svg(shown, width)) for width in (Illustration.WIDE, Illustration.NARROW)):
        assert all(found.count(word) >= 1 for word in named)
        assert len(found) == len(named) + 1 + bool(any(mechanism.gravity))  # the scale and g


def test_names_keep_clear_of_each_other_of_lines_and_of_the_edge():
    corner = np.array([[5.0, 5.0]])
    names = [Name(f"joint {k}", "joint", corner) for k in range(6)]
    line = np.stack([np.linspace(0.0, 200.0, 50), np.full(50, 25.0)], axis=-1)
    placed = place_names(names, line, 300.0, 200.0)
    boxes = [(one.left, one.top, one.left + one.name.width, one.top + LINE) for one in placed]
    for number, (left, top, right, bottom) in enumerate(boxes):
        assert left >= 0
        assert top >= 0
        assert not np.any((line[:, 0] > left) & (line[:, 0] < right) & (line[:, 1] > top) & (line[:, 1] < bottom))
        for other in boxes[:number]:
            assert left >= other[2] or right <= other[0] or top >= other[3] or bottom <= other[1]


def test_long_and_hostile_names_are_cut_and_escaped():
    m = mbdkit.Mechanism()
    m.body("<script>" + 240 * "x", mass=1.0, inertia=1.0)
    svg = mechanism_svg(start(m), Illustration.WIDE)
    assert "<script" not in svg
    assert max(map(len, texts(svg))) < 40


def test_the_arrow_of_a_load_points_where_the_force_does():
    # expected: of a force (3, 4) N, the arrow runs to the right by three fifths of its length, and upwards (down the
    # SVG's axis) by four fifths
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("block", mass=1.0, inertia=1.0)
    m.force("push", "block", value=("3*t", "4*t"))
    svg = mechanism_svg(start(m), Illustration.WIDE)
    x0, y0, x1, y1 = map(float, re.search(r'class="load" d="M([\d.]+) ([\d.]+)L([\d.]+) ([\d.]+)"', svg).groups())
    length = math.dist((x0, y0), (x1, y1))
    assert ((x1 - x0) / length, (y0 - y1) / length) == pytest.approx((0.6, 0.8), abs=0.01)


def test_a_motor_is_drawn_at_its_own_joint_where_ends_of_other_bars_meet():
    m = mbdkit.Mechanism()
    crank = m.body("crank", mass=1.0, inertia=1.0, position=(0.5, 0.0))
    foot = m.body("foot", mass=1.0, inertia=1.0, position=(-2.0, -2.0))
    m.distance("ground bar", m.ground, foot, from_=(-3.0, 0.0), to=(-2.0, -1.0))
    m.distance("crank bar", crank, foot, from_=(1.0, 0.0), to=(-2.0, -1.0))
    m.revolute("axle", m.ground, crank, at=(0.0, 0.0))
    m.driver("motor", m.ground, crank, coordinate="angle", motion="t")
    svg = mechanism_svg(start(m), Illustration.WIDE)
    axle = [float(number) for number in re.search(r'<circle class="joint" cx="([\d.]+)" cy="([\d.]+)"', svg).groups()]
    turn = re.search(r'class="load" d="M([\d.]+) ([\d.]+)', svg).groups()
    assert math.dist(axle, [float(number) for number in turn]) == pytest.approx(15.0, abs=0.2)  # px, its radius


def test_the_tables_say_what_the_spec_says():
    m = driven_wheel()
    m.marker("rim", "wheel", point=(5.551e-17, 0.5))  # as a difference of global coordinates leaves
    with mbdkit.run(m, integrator={"name": "rk4"}, time={"end": 0.1, "step": 0.01}) as run:
        section = run_report(run).sections[0]
    tables = {table.name: table for table in section.tables}
    assert tables["bodies"].rows == (("wheel", 1.0, 0.5, 0.3, 0.0, 0.0),)
    assert [row[:3] for row in tables["model-joints"].rows] == [
        ("hub", "revolute", "ground - wheel"),
        ("motor", "driver", "ground - wheel"),
    ]
    assert tables["model-joints"].rows[1][-1] == "angle = sin(2*t) rad"
    assert [row[-1] for row in tables["model-forces"].rows] == ["stiffness 3 N m/rad", "stiffness 5 N/m"]
    (marker,) = tables["markers"].rows
    assert marker[:4] == ("rim", "wheel", 0.0, 0.5)
    assert marker[4:] == pytest.approx((0.3, 0.5))
    assert section.sentences[0].startswith("A planar mechanism of 1 body, 1 joint, 1 driver and 2 force elements")


def test_parameters_are_listed_with_their_values():
    with mbdkit.run("quick-return", time={"end": 0.02, "step": 0.01}) as run:
        tables = {table.name: table for table in run_report(run).sections[0].tables}
    rows = {row[0]: row[1:] for row in tables["parameters"].rows}
    assert rows["crank"] == (None, 0.1)
    assert rows["start"] == ("degrees(60)", pytest.approx(math.pi / 3))


def test_measures_that_were_asked_are_named_in_every_form():
    measures = {"low": "min(rod1.y)", "high": {"value": "max(rod1.y)", "unit": "m"}, "far": {"name": "of-a-plugin"}}
    asked = model_section._asked(SimpleNamespace(spec={"measures": measures}, time=[0.0, 1.0]))
    assert asked == "low = min(rod1.y), high = max(rod1.y) and far = of-a-plugin, from t = 0 s to 1 s"


def test_without_its_mechanism_a_run_shows_what_its_archive_holds(make_run):
    document = run_report(make_run(model={"name": "acme:crane"}))
    assert (glance := document.glance) is not None
    section = document.sections[0]
    (sentence,) = section.sentences
    assert sentence.startswith(
        "Only points of bodies are drawn: the mechanism of this run is not stored, and the model "
    )
    assert [table.name for table in section.tables] == ["bodies"]
    assert [len(row) for row in section.tables[0].rows] == [4, 4]
    assert {"rod1", "rod2"} <= set(texts(glance.drawing.wide))


def test_a_cable_is_drawn_beside_its_joints() -> None:
    # expected: thigh and shank hang straight down from the hip at the origin. To raise the angle of the hip, the cable
    # passes it on the side of +x: there its pull up along the thigh turns the thigh counter-clockwise.
    m = walker()
    m.cable("tendon", {"hip": 0.05, "knee": -0.03}, stiffness=1e4, acts="tension")
    drawing = draw_mechanism(m)
    assert len(drawing.springs) == 2
    ends = drawing.world(np.array([[0, -0.2, -np.pi / 2], [0, -0.6, -np.pi / 2]]))[np.array(drawing.springs)]
    np.testing.assert_allclose(ends, [[[0.05, 0], [-0.03, -0.4]], [[-0.03, -0.4], [-0.03, -0.6]]], atol=1e-15)


def test_the_report_draws_and_names_a_cable() -> None:
    m = walker()
    m.cable("tendon", {"hip": 0.05, "knee": -0.03}, stiffness=1e4, acts="tension")
    run = mbdkit.run(m, integrator={"name": "rk4"}, time=SWEEP)
    pose = run.array("trajectory/position")[0]
    drawn = str(mechanism_svg(NamedPose.of(m, run.bodies, pose, run.time), 600.0))
    assert "tendon" in drawn
    assert drawn.count('class="spring') == 2


def test_laws_between_two_points_are_drawn_as_springs() -> None:
    m = Mechanism()
    m.body("arm", mass=1.0, inertia=0.1, position=(0.5, 0.0))
    m.body("ball", mass=1.0, position=(1.0, 0.5))
    m.law("stop", m.ground, "arm", law="one-sided", from_=(0, 1), to=(0.5, 0), stiffness=9.0, acts="tension")
    m.law("bush", "arm", "ball", law="table", along="y", table=np.array([[0.0, 0.5, 1.0], [-3.0, 0.0, 2.0]]))
    m.law("mine", m.ground, "ball", law="linear", points=((0, 0), (0, 0)), stiffness=3.0)
    drawing = draw_mechanism(m)
    assert len(drawing.springs) == 2
    ends = drawing.world(np.array([[0.5, 0.0, 0.0], [1.0, 0.5, 0.0]]))[np.array(drawing.springs)]
    np.testing.assert_allclose(ends, [[[0, 1], [0.5, 0]], [[0, 0], [1, 0.5]]], atol=1e-15)


USES: dict[str, tuple[list[tuple[str, str]], str]] = {
    "alone": ([("k", "N m/rad")], "N m/rad"), "share": ([("L/2 + k", "m"), ("-k", "m")], "m"),
    "rate": ([("k*t", "rad")], "rad/s"), "rate in degrees": ([("degrees(k)*t", "rad")], "deg/s"),
    "argument": ([("3.7*sin(k*t)", "N m")], "rad/s"), "frequency": ([("F*sin(2*pi*k*t)", "N")], "Hz"),
    "amplitude": ([("k*sin(2*pi*f*t)", "N")], "N"), "speed": ([("0.1 + k*t", "m")], "m/s"),
    "with a parameter": ([("k*L", "N m")], "N"), "denominator": ([("L/k", "m/s")], "s"),
    "constant of nature": ([("9.81*k", "N")], ""), "contradiction": ([("k", "m"), ("k", "kg")], ""),
    "power": ([("k**2", "m^2")], ""), "two units": ([("k", "N or N m")], ""), "other parameter": ([("L", "m")], ""),
}  # fmt: skip


@pytest.mark.parametrize(("uses", "unit"), USES.values(), ids=USES)
def test_the_unit_of_a_parameter_follows_from_its_uses(uses: list[tuple[str, str]], unit: str) -> None:
    assert unit_of_use("k", uses, {"L": read_unit("m"), "f": read_unit("Hz")}) == unit


def same(first: Drawing, second: Drawing) -> bool:
    rest = {"owner": None, "local": None}
    return (
        vars(first) | rest == vars(second) | rest
        and np.array_equal(first.owner, second.owner)
        and np.array_equal(first.local, second.local)
    )


@pytest.mark.parametrize("name", [*example_names("run"), *example_names("inverse")])
def test_the_stored_mechanism_of_an_example_is_drawn_as_the_one_that_its_model_builds(name: str) -> None:
    load = load_inverse_spec if name in example_names("inverse") else load_spec
    built = load(name).mechanism()
    read = read_mechanism(mechanism_json(built), list(built.bodies))
    assert read.not_drawn == ""
    assert read.mechanism is not None
    assert read.mechanism.to_spec() == built.to_spec()
    assert same(draw_mechanism(read.mechanism), draw_mechanism(built))


def test_elements_of_unknown_kinds_and_those_that_refer_to_them_are_named_and_the_others_drawn() -> None:
    data = json.loads(mechanism_json(swing()))
    data["joints"]["thread"] = {"type": "screw", "bodies": ["ground", "rod"], "pitch": 0.1}
    cable = {"type": "joint-angles", "angles": {"thread": 0.1}}
    data["forces"]["cable"] = {"type": "law", "law": "linear", "pathway": cable, "stiffness": 1.0}
    data["forces"]["spring"]["later"] = 1.0
    read = stored(data)
    assert read.not_drawn == "not drawn, because not known here: joints.thread, forces.spring, forces.cable"
    assert list(read.mechanism.joints) == ["pin"]
    assert draw_mechanism(read.mechanism).pins


def test_options_of_a_law_of_a_plugin_are_kept_without_the_plugin() -> None:
    data = json.loads(mechanism_json(swing()))
    pathway = {"type": "two-points", "bodies": ["ground", "rod"], "points": [[0.0, 1.0], [0.5, 0.0]]}
    data["forces"]["pull"] = {"type": "law", "law": "acme:spring", "pathway": pathway, "pretension": 5.0}
    read = stored(data)
    assert read.not_drawn == ""
    assert dict(read.mechanism.forces["pull"])["pretension"] == 5.0
    assert len(draw_mechanism(read.mechanism).springs) == 2


def test_a_mechanism_of_more_than_64_kib_is_stored(tmp_path: Path) -> None:
    model = {"name": "n-pendulum", "n": 500}
    with mbdkit.run({"mbdkit": 1, "model": model, **SHORT}, archive=tmp_path / "a.h5") as run:
        assert len(run.file.attrs["mechanism"]) > 1 << 16
        built = mbdkit.RunSpec(mbdkit=1, model=model, **SHORT).mechanism()
        assert same(draw_run(run), draw_mechanism(built))


def test_an_archive_that_lacks_the_mechanism_of_a_plugin_is_drawn_as_points_and_says_so(tmp_path: Path) -> None:
    with mbdkit.run(swing(), archive=tmp_path / "a.h5", **SHORT) as run:
        spec = dict(run.spec)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file.attrs["mechanism"]
        file.attrs["spec"] = json.dumps(spec | {"model": {"name": "acme:crane", "file": str(tmp_path / "secret")}})
        seal(file)
    with mbdkit.load(tmp_path / "a.h5") as run:
        assert "the model 'acme:crane' is of a plugin, which may read files" in run.not_drawn
        assert draw_run(run).pins == ()
        with pytest.raises(mbdkit.ArchiveError, match="only points of bodies"):
            assert run.mechanism
