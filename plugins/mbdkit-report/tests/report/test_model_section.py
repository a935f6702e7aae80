"""The first section of a report: the drawing with names, and the tables of the model."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import mbdkit
from mbdkit.mechanism.beams import parts_of
from mbdkit.spec import example_names, load_spec
from mbdkit_report import Illustration, NamedPose, run_report
from mbdkit_report.figures.label_placement import LINE, Name, place_names
from mbdkit_report.figures.mechanism_drawing import mechanism_svg, names_shown
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


@pytest.mark.parametrize("name", sorted(example_names("run")))
def test_every_element_of_an_example_is_named_once(name):
    mechanism = load_spec(name).mechanism()
    shown = start(mechanism)
    if not names_shown(shown):
        return
    parts = parts_of(mechanism.beams)
    named = [*mechanism.bodies, *mechanism.joints, *mechanism.forces, *mechanism.markers]
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


def test_without_its_mechanism_a_run_shows_what_its_archive_holds(make_run):
    document = run_report(make_run(model={"name": "acme:crane"}))
    section = document.sections[0]
    (sentence,) = section.sentences
    assert sentence.startswith(
        "Only points of bodies are drawn: the mechanism of this run is not stored, and the model "
    )
    assert [table.name for table in section.tables] == ["bodies"]
    assert [len(row) for row in section.tables[0].rows] == [4, 4]
    assert {"rod1", "rod2"} <= set(texts(section.drawing.wide))
