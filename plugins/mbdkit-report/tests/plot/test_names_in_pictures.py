"""What pictures must name: a list by hand from the specs, compared with the records of pictures, not with pixels."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure as Picture
from matplotlib.text import Annotation

import mbdkit
from mbdkit import Run
from mbdkit_report import Axis, Figure, Line, film_of, run_report
from mbdkit_report.figures.palette import line_styles
from mbdkit_report.figures.scene import scene
from mbdkit_report.plot.plot_kinds import plot_module

#: Names in every picture, the legend of what is drawn besides bodies, and the curves of charts, by example.
GOLDEN: dict[str, Any] = {
    "slider-crank": {
        "names": {"A", "B", "C", "guide", "crank", "rod", "slider", "buffer"},
        "key": ["buffer"],
        "reactions": ["A", "B", "C", "guide"],
        "torques": ["motor"],
    },
    "knee": {
        "names": {"A", "B", "C", "D", "acl", "pcl", "shank", "support", "knee-damping"},
        "key": ["knee-damping, support"],
        "reactions": ["A", "B", "C", "D"],
        "torques": ["knee-damping"],
    },
    "knee-orthosis": {
        "names": {"hip", "knee", "hinge", "thigh", "shank", "upper_bar", "lower_bar", "hold"},
        "key": ["hold", "thigh, shank"],
        "reactions": ["hip", "knee", "hinge"],
    },
    "elbow-curl": {
        "names": {"elbow", "grip", "forearm", "weight", "hand", "biceps", "brachialis", "triceps"},
        "key": ["biceps, brachialis, triceps"],
        "reactions": ["elbow", "grip"],
    },
}


@pytest.fixture(scope="module", params=GOLDEN)
def example(request: pytest.FixtureRequest) -> tuple[Run, dict[str, Any]]:
    step = mbdkit.load_spec(request.param).time.step
    return mbdkit.run(request.param, time={"end": 5 * step, "step": step}), GOLDEN[request.param]


def test_trajectory_animation_and_drawing_name_joints_bodies_and_devices(example: tuple[Run, dict[str, Any]]) -> None:
    run, golden = example
    film: Any = film_of(run, 3_000)
    axes = Picture().add_subplot()
    plot_module("trajectory").panels(run)[0].draw(axes)
    names = golden["names"]
    assert {name[0] for name in film["names"]} == names
    assert {tag.text for tag in scene(run, rate=5, most=5, shortest=1, longest=1).tags} == names
    assert {text.get_text() for text in axes.findobj(Annotation) if text.get_text()} == names
    glance = run_report(run).glance
    assert glance is not None
    assert glance.drawing is not None
    for svg in (glance.drawing.wide, glance.drawing.narrow):
        assert names <= set(re.findall(r"<text[^>]*>([^<]*)</text>", svg))


def test_legends_name_devices_and_curves(example: tuple[Run, dict[str, Any]]) -> None:
    run, golden = example
    film: Any = film_of(run, 3_000)
    assert [text for text, _ in film["key"]] == golden["key"]
    axes = Picture().add_subplot()
    plot_module("trajectory").panels(run)[0].draw(axes)
    assert set(golden["key"]) <= {text.get_text() for text in axes.get_legend().get_texts()}
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    for kind in ("reactions", "torques"):
        if kind in golden:
            assert [line.label for line in plot_module(kind).chart(run).lines] == golden[kind]


def test_lines_that_coincide_are_told_apart_by_dashes() -> None:
    x = np.linspace(0.0, 1.0, 500)
    sine = np.sin(6 * x)
    curves = {"A": sine, "B": -sine, "on A": sine + 0.002, "also on A": sine - 0.002, "apart": sine + 0.1}
    lines = tuple(Line(name, x, y) for name, y in curves.items())
    chart = Figure("c", "C", "", Axis("x"), Axis("y"), lines)
    assert [style for _, style in line_styles(chart)] == [0, 0, 1, 2, 0]
    paths = tuple(Line(name, np.cos(turn), np.sin(turn)) for name, turn in {"A": 6 * x, "later": 6 * x + 0.05}.items())
    circle = Figure("c", "C", "", Axis("x"), Axis("y"), paths, equal=True)
    assert [style for _, style in line_styles(circle)] == [0, 1]


def test_pairs_of_lines_of_one_colour_differ_in_dashes_and_markers() -> None:
    x = np.linspace(1.0, 2.0, 5)
    lines = tuple(Line(f"method {k}", x, x + k, "both") for k in range(11))
    styles = line_styles(Figure("c", "C", "", Axis("x"), Axis("y"), lines))
    assert len(set(styles)) == 11
    assert styles[0][0] == styles[6][0]  # six colours
