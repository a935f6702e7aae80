"""The page of the report of a run, study or design: its contents, the JSON data of its charts, and its HTML."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from mbdkit.base.distributions import own_version
from mbdkit_report.analysis.verdict import Answer, Verdict
from mbdkit_report.figures.page_model import Axis, Cell, Column, Figure, Section, Stated, Table, columns_of
from mbdkit_report.figures.palette import color_key, color_number, line_styles
from mbdkit_report.pages.methods_used import Methods
from mbdkit_report.pages.templating import render

_MARKS = {Answer.YES: "\u2713", Answer.NO: "\u2717", Answer.PARTLY: "\u25d0", Answer.OPEN: "?"}
_NO_FAILURES = Table("failures", "Runs that failed", columns_of("run; reason"), ())


@dataclass(frozen=True)
class ReportPage:
    """Contents of a report.

    Parameters
    ----------
    title
        Heading.
    settings
        Line with the main settings.
    verdict
        The verdict with its charts and tables.
    methods
        Paragraphs on the methods, with references.
    environment
        Table of the provenance: versions and machine.
    reproduce, commands
        How to reproduce the results: a sentence, and commands for a terminal.
    spec, spec_file
        Text of the spec, and the name of the file in which readers save it.
    alarm
        Warning at the top; empty if there is none.
    headline
        Labels and texts of the main results of the run, study or design, which are shown first, and their ids; by
        default, the label is the id.
    remarks, remarks_title
        Labels and texts of remarks on single runs, which are folded below the headlines, and their title.
    tone
        Colour of the first headline, which is the verdict: ``good``, ``warn`` or ``alarm``; empty without a colour.
    glance
        Section above all others: the question, the doubt, and a drawing; None if there is none.
    films
        Data of the animations, as returned by `film_data`.
    failures
        Table of the failed runs with the reasons.
    sections
        Further sections. Those that show results, such as the largest forces, are above the verdict; those that show
        the input, such as the model, are below it.
    beside_verdict
        Names of the tables and charts that are shown below the claims of the verdict instead of among the others.
    begins_with_verdict
        Whether the verdict precedes the animations and the other results.
    """

    title: str
    settings: str
    verdict: Verdict
    methods: Methods
    environment: Table
    reproduce: str
    commands: str
    spec: str
    spec_file: str
    alarm: str = ""
    headline: tuple[tuple[str, str] | tuple[str, str, str], ...] = ()
    remarks: tuple[tuple[str, str], ...] = ()
    remarks_title: str = ""
    tone: str = ""
    sections: tuple[Section, ...] = ()
    beside_verdict: tuple[str, ...] = ()
    begins_with_verdict: bool = False
    glance: Section | None = None
    films: tuple[dict[str, Any], ...] = ()
    failures: Table = _NO_FAILURES

    @property
    def contents(self) -> list[tuple[str, str]]:
        """Anchor and title of each section, in order."""
        return _headings(self.html())

    def figures(self, *, beside: bool) -> tuple[Figure, ...]:
        """Return the charts shown below the claims of the verdict if `beside` is true, otherwise the other charts."""
        return tuple(figure for figure in self.verdict.figures if (figure.name in self.beside_verdict) == beside)

    def tables(self, *, beside: bool) -> tuple[Table, ...]:
        """Return the tables shown below the claims of the verdict if `beside` is true, otherwise the other tables."""
        return tuple(table for table in self.verdict.tables if (table.name in self.beside_verdict) == beside)

    @property
    def figure_data(self) -> dict[str, object]:
        """Data of the charts, as JSON values."""
        return charts_data(self.verdict.figures)

    @property
    def summaries(self) -> dict[str, Table]:
        """The text alternative of each chart, as a table, by name of the chart."""
        return {figure.name: _summary(figure) for figure in self.verdict.figures}

    def html(self) -> str:
        """Return the HTML."""
        return render("report.html", {"page": self, "version": own_version()}, FILTERS | {"headings": _headings})


def cell_text(value: Cell) -> str:
    """Return a cell of a table as text."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Stated):
        return value.text
    if isinstance(value, float):
        if math.isnan(value):
            return "-"
        return f"{value:,.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.4g}"
    return f"{value:,}" if isinstance(value, int) else value


def _exact(value: Cell) -> str:
    """Return a number of a table with all its digits, for sorting and downloads; empty for other values."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return repr(float(value) if isinstance(value, float) else value) if is_number and math.isfinite(value) else ""  # type: ignore[arg-type]


def _is_numeric(table: Table, column: int) -> bool:
    cells = [row[column] for row in table.rows if row[column] is not None]
    return bool(cells) and all(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in cells)


def _headings(html: str) -> list[tuple[str, str]]:
    """Return anchor and title of each section of a page."""
    return [(anchor, Markup(title).unescape()) for anchor, title in re.findall(r'<h2 id="([^"]*)">(.*?)</h2>', html)]


#: Filters that the macros in `templates/parts.html` use.
FILTERS: dict[str, Callable[..., object]] = {
    "cell": cell_text,
    "exact": _exact,
    "id": lambda cell: getattr(cell, "id", ""),
    "mark": _MARKS.__getitem__,
    "numeric": _is_numeric,
}


def _summary(figure: Figure) -> Table:
    """Return a table of the points of a chart. If they are many, the table contains instead the first, last, smallest
    and largest value of each curve.
    """
    x, y = figure.x.title, figure.y.title
    seen = [(line, figure.visible(line)) for line in figure.lines]
    if sum(int(np.sum(mask)) for _, mask in seen) <= 60:
        rows: Sequence[tuple[Cell, ...]] = [
            (line.label, float(a), float(b))
            for line, mask in seen
            for a, b in zip(line.x[mask], line.y[mask], strict=True)
        ]
        return Table(figure.name, f"Points of {figure.title}", (Column("curve"), Column(x), Column(y)), tuple(rows))
    rows = []
    for line, mask in seen:
        if np.any(mask):
            at, values = line.x[mask], line.y[mask]
            result = (values[0], values[-1], values.min(), values.max(), at[values.argmax()])
            rows.append((line.label, *map(float, result)))
    columns = ("curve", "first", "last", "smallest", "largest", f"largest at {x}")
    title = f"Ends and extremes of {figure.title}, {y}"
    return Table(figure.name, title, tuple(Column(name) for name in columns), tuple(rows))


#: Dash patterns that distinguish lines of the same colour.
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x")

Numbers = list[float | None]


def charts_data(charts: Iterable[Figure]) -> dict[str, object]:
    """Return the JSON data of charts: ``figures`` by name, and ``columns``, the arrays of numbers that the lines refer
    to by index.

    Equal arrays, such as the times of several lines, are a single column.
    """
    columns: dict[tuple[float | None, ...], int] = {}

    figures = {}
    for chart in charts:
        figures[chart.name] = data = chart_data(chart)
        for line in data["lines"]:
            line |= {key: columns.setdefault(tuple(line[key]), len(columns)) for key in ("x", "y")}
    return {"figures": figures, "columns": list(columns)}


def chart_data(chart: Figure) -> dict[str, Any]:
    """Return the JSON data of a chart."""
    return {
        "name": chart.name,
        "title": chart.title,
        "x": _axis_data(chart.x),
        "y": _axis_data(chart.y),
        "equal": chart.equal,
        "bands": [{"label": band.label, "low": band.low, "high": band.high} for band in chart.bands],
        "marks": [{"label": mark.label, "x": mark.x} for mark in chart.marks],
        "guides": [
            {"label": guide.label, "x": _numbers(guide.x, chart.x), "y": _numbers(guide.y, chart.y)}
            for guide in chart.guides
        ],
        "lines": [
            {
                "label": line.label,
                "x": _numbers(line.x, chart.x),
                "y": _numbers(line.y, chart.y),
                "band": None if line.band is None else _outline(line.band, chart),
                "kind": line.kind,
                "color": color_key(color),
                "is_emphasized": line.is_emphasized,
                "dash": DASHES[style % len(DASHES)],
                "symbol": SYMBOLS[(color_number(color) + style) % len(SYMBOLS)],
            }
            for line, (color, style) in zip(chart.lines, line_styles(chart), strict=True)
        ],
    }


def _outline(corners: np.ndarray, chart: Figure) -> dict[str, Numbers]:
    return {"x": _numbers(corners[:, 0], chart.x), "y": _numbers(corners[:, 1], chart.y)}


def _axis_data(axis: Axis) -> dict[str, object]:
    return {"title": axis.title, "unit": axis.unit, "log": axis.log}


def _numbers(values: np.ndarray, axis: Axis) -> Numbers:
    """Return values rounded to seven digits; None in place of values that the axis cannot show."""
    return [
        float(f"{value:.7g}") if abs(value) < np.inf and (value > 0 or not axis.log) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]
