"""Beams in pictures: one smooth curve for each beam, and its internal forces along it and over time."""

from __future__ import annotations

import re

import numpy as np
import pytest

import mbdkit
from mbdkit.base.errors import SpecError, UnknownNameError
from mbdkit_report import Illustration, NamedPose, draw_mechanism
from mbdkit_report.figures.beam_curves import bending_moments, bezier_polylines
from mbdkit_report.figures.mechanism_drawing import mechanism_svg
from mbdkit_report.figures.palette import body_colors
from mbdkit_report.figures.player_data import film_data
from mbdkit_report.pages.answer_section import beam_section
from mbdkit_report.pages.model_section import element_tables
from mbdkit_report.pages.run_report import mechanism_of

RADIUS, BENDING = 0.5, 3.0


def arc(turn, count):
    """Return x, y and angle of points on a circle of `RADIUS`."""
    angle = np.linspace(0.0, turn, count)
    return np.stack([RADIUS * np.sin(angle), RADIUS * (1 - np.cos(angle)), angle], axis=-1)


def bent_mechanism(nodes=2, **properties):
    """Return a straight beam that starts bent into a quarter of a circle, with a body and a distributed load."""
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("weight", mass=1.0, inertia=0.1, position=(RADIUS, RADIUS))
    start = [tuple(row) for row in arc(np.pi / 2, 8 * (nodes - 1) + 1).tolist()]
    m.beam("leaf", a=(0, 0), b=(RADIUS * np.pi / 2, 0), elements=8, nodes=nodes, mass_per_length=1.0, start=start,
           stiffness={"axial": 1e4, "shear": 1e4, "bending": BENDING}, load=(0.0, -1.0), **properties)  # fmt: skip
    m.weld("clamp", m.ground, "leaf.0", at=(0.0, 0.0))
    m.revolute("pin", f"leaf.{8 * (nodes - 1)}", "weight", at=(RADIUS, RADIUS))
    return m


@pytest.fixture(scope="module")
def run():
    return mbdkit.run(bent_mechanism(), integrator={"name": "radau-iia"}, time={"end": 0.01, "step": 1e-3})


@pytest.mark.parametrize("nodes", [2, 3])
def test_a_beam_bent_into_an_arc_is_drawn_as_an_arc(nodes):
    mechanism = bent_mechanism(nodes)
    drawing = draw_mechanism(mechanism)
    pose = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    lines = bezier_polylines(drawing.world(pose)[list(drawing.beams[0].corners)])
    assert lines.shape == (8 * (nodes - 1), 7, 2)
    np.testing.assert_allclose(np.hypot(lines[..., 0], lines[..., 1] - RADIUS), RADIUS, rtol=1e-5)


def test_a_beam_is_one_link_and_its_nodes_are_none():
    drawing = draw_mechanism(bent_mechanism())
    assert drawing.links == ("weight", "leaf")
    assert len(set(body_colors(drawing))) == 2
    assert drawing.link_numbers == (0, *[1] * 9)


def test_a_report_names_a_beam_once_and_never_its_nodes(run):
    mechanism = mechanism_of(run)
    pose = run.array("trajectory/position")[0]
    shown = NamedPose.of(mechanism, list(run.bodies), pose, np.array([0.0]))
    names = re.findall(r"<text[^>]*>([^<]*)</text>", mechanism_svg(shown, Illustration.NARROW))
    assert names.count("leaf") == 1
    assert not [name for name in names if "leaf." in name]
    tables = {table.name: table for table in element_tables(shown)}
    assert [row[0] for row in tables["bodies"].rows] == ["weight"]
    assert [row[0] for row in tables["model-beams"].rows] == ["leaf"]
    assert "model-forces" not in tables


def test_the_moment_of_a_circular_arc_is_bending_stiffness_by_radius(run):
    axes = run.plot.beams(times=0.0)
    (line,) = axes.get_lines()
    share = np.array([0.0, *(np.arange(8) + 0.5), 8.0]) / 8
    np.testing.assert_allclose(line.get_xdata(), RADIUS * np.pi / 2 * share, rtol=1e-12)
    np.testing.assert_allclose(line.get_ydata(), BENDING / RADIUS, rtol=1e-12)
    over_time = run.plot.beams(components="axial").get_lines()[0]
    assert len(over_time.get_xdata()) == len(run.time)


def test_the_section_on_beams_tells_the_largest_moment_and_colours_the_curve(run):
    section = beam_section(run, mechanism_of(run))
    (table,) = section.tables
    assert table.rows[0][1] >= BENDING / RADIUS * (1 - 1e-12)
    assert section.drawing.wide.count('class="beam"') > 8
    assert "color-mix" in section.drawing.wide


def test_the_player_gets_the_curve_and_its_moments_in_percent(run):
    film = film_data(run, 10_000)
    assert [name for name, _ in film["links"]] == ["weight", "leaf"]
    moments = bending_moments(run, draw_mechanism(bent_mechanism()).beams)
    assert film["bending"]["largest"] == np.max(np.abs(moments))
    assert film["bending"]["percent"][:8] == np.round(100 * moments[0] / np.max(np.abs(moments))).tolist()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"components": "torsion"}, SpecError, "moment, shear or axial"),
        ({"times": [5.0]}, SpecError, "recorded 0 to 0.01 s"),
        ({"beams": "lief"}, UnknownNameError, "leaf"),
    ],
)
def test_wrong_options_are_named(run, options, error, words):
    with pytest.raises(error, match=words):
        run.plot.beams(**options)


def test_a_run_without_beams_says_so():
    with pytest.raises(SpecError, match="no beams"):
        mbdkit.run("pendulum", time={"end": 0.01, "step": 0.01}).plot.beams()


def test_the_summary_counts_a_beam_and_not_its_nodes(run):
    assert "mechanism, 1 body, 1 beam, 2 joints" in run.summary()
