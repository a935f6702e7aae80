"""The display of each kind of object in notebooks: sentences, pictures and tables as HTML that loads no other files."""

from __future__ import annotations

import base64
import html
from dataclasses import dataclass, replace
from functools import singledispatch
from typing import Never, cast

import numpy as np
from matplotlib.figure import Figure

from mbdkit.archive.accuracy import Accuracy
from mbdkit.archive.history import JointHistories
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import answer_lines, summary_lines
from mbdkit.base.errors import MbdkitError
from mbdkit.base.html_view import HtmlView
from mbdkit.base.text import shown
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.feature_items import ViewItem
from mbdkit.registry.manager import registry
from mbdkit.registry.seam import OwnSeam
from mbdkit_report.figures.curves import take
from mbdkit_report.figures.drawing_geometry import mechanism_of
from mbdkit_report.figures.mechanism_drawing import NamedPose
from mbdkit_report.figures.page_model import Cell, Illustration, Table, columns_of
from mbdkit_report.figures.plane_geometry import Array
from mbdkit_report.pages.model_section import composition, drawing, element_tables
from mbdkit_report.pages.report_page import FILTERS
from mbdkit_report.pages.run_report import TONES
from mbdkit_report.pages.templating import render
from mbdkit_report.plot import drift_plot, reactions_plot
from mbdkit_report.plot.caption import caption
from mbdkit_report.plot.charts import chart_image
from mbdkit_report.plot.style import png


@dataclass(frozen=True)
class Picture:
    """A Matplotlib figure with a description for readers who do not see it."""

    figure: Figure
    description: str

    @property
    def source(self) -> str:
        """The figure as a data URL."""
        return f"data:image/png;base64,{base64.b64encode(png(self.figure)).decode('ascii')}"

    @property
    def width(self) -> int:
        """Width on the page [px]."""
        return round(float(self.figure.get_size_inches()[0]) * 96)


@dataclass(frozen=True)
class View:
    """The content that a notebook shows for an object.

    Parameters
    ----------
    title
        Heading.
    sentences
        Paragraphs below it.
    tone
        ``good``, ``warn`` or ``alarm`` if the first paragraph has a colour.
    facts
        Labels and texts, as in a summary; a text without a label continues the one above.
    drawing, pictures
        Illustration of the mechanism, and other pictures.
    tables
        Tables with their titles.
    is_folded
        Whether tables are closed until the reader opens them.
    """

    title: str
    sentences: tuple[str, ...] = ()
    tone: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    drawing: Illustration | None = None
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    is_folded: bool = False

    def html(self) -> str:
        """Return the HTML; all texts are escaped."""
        return render("notebook.html", {"view": self}, FILTERS)


_CHART = (5.4, 3.3)  #: Width and height of a chart of a run [inch].


@OwnSeam
def object_view(result: Never, /) -> View:
    """Return what notebooks show of an object."""
    raise NotImplementedError


def html_of(thing: HtmlView) -> str:
    """Return the HTML of an object; if it cannot be read, like a closed run, the HTML states the reason."""
    try:
        return view(thing).html()
    except MbdkitError as error:
        return f"<pre>{html.escape(shown(f'{thing!r}: {error}'))}</pre>"


@singledispatch
def view(thing: HtmlView) -> View:
    """Return the view of an object: that of a plugin, or one of this file."""
    classes = {f"{one.__module__}:{one.__qualname__}" for one in type(thing).__mro__}
    for item in registry().of_kind("view"):
        result = cast(ViewItem, item.plugin)
        if result.of in classes:
            return object_view.of(result.make)(thing)
    raise TypeError(f"there is no view for a {type(thing).__name__}: a plugin can add an item `ViewItem`")


@view.register
def _(run: Run) -> View:
    (_, verdict), *lines = summary_lines(run)
    sentences, tone = [f"Verdict {verdict}"], TONES.get(run.verdict, "")
    while lines and not lines[0][0]:
        sentences.append(lines.pop(0)[1])
    title = f"Run: {caption(run).title}"
    answers = [text for _, text in answer_lines(run)]
    sentences += answers
    lines = [line for line in lines if line[0] != "run" and line[1] not in answers]  # the title names the run
    if not len(run.time):
        return View(title, tuple(sentences), tone, tuple(lines))
    pose = take(run.dataset("trajectory/position"), np.array([0], dtype=np.intp))[0]
    named = NamedPose.of(mechanism_of(run), list(run.bodies), pose, np.asarray(run.time)[:1])
    charts = [*reactions_plot.charts(run), *drift_plot.charts(run)[:1]]
    pictures = tuple(
        Picture(chart_image(replace(chart, caption=""), *_CHART), f"{chart.title}. {chart.caption}") for chart in charts
    )
    return View(title, tuple(sentences), tone, tuple(lines), drawing(named), pictures)


@view.register
def _(mechanism: Mechanism) -> View:
    title = "Mechanism" if mechanism.name == "mechanism" else f"Mechanism {mechanism.name}"
    if not mechanism.bodies:
        return View(title, ("It has no bodies yet.",))
    pose = np.array([(*body.position, body.angle) for body in mechanism.bodies.values()])
    named = NamedPose.of(mechanism, list(mechanism.bodies), pose, np.zeros(1))
    tables = tuple(element_tables(named))
    return View(title, (composition(mechanism),), drawing=drawing(named), tables=tables, is_folded=True)


@view.register
def _(found: Accuracy) -> View:
    largest = [
        ("position", "m", found.position_error_max),
        ("angle", "rad", found.angle_error_max),
        ("reaction force", "N", _largest(found.reaction_error, found.rows_known)),
        ("reaction torque", "N m", _largest(found.torque_error, found.rows_known)),
    ]
    until = "of all rows" if found.is_complete else f"until {found.known_until:.4g} s"
    table = Table("errors", f"Largest estimated errors {until}", columns_of("quantity; unit; error"), tuple(largest))
    return View("Accuracy", (found.method,), tables=(table,))


@view.register
def _(joints: JointHistories) -> View:
    rows: list[tuple[Cell, ...]] = []
    for name, joint in joints.items():
        force, torque = np.linalg.norm(joint.reaction_force, axis=1), np.abs(joint.reaction_torque)
        rows.append((name, " - ".join(joint.bodies), _largest(force), _largest(torque), joint.misalignment_max))
    columns = columns_of("joint; between; largest force [N]; largest torque [N m]; largest misalignment [m]")
    return View("Joints", tables=(Table("joints", "Largest values in the recorded rows", columns, tuple(rows)),))


def _largest(values: Array, rows: int | None = None) -> float:
    return float(np.max(values[:rows], initial=0.0))
