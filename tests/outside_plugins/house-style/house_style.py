"""A section of reports, a kind of plots, and a format of exported tables."""

import numpy as np

from mbdkit.plugin import PlotKind, ReportSection, TableFormat, Target, hookimpl
from mbdkit.plugin.reports import Axis, Figure, Line, Section, Table, columns_of, report_sections, table_writer


def speeds(run):
    return {name: np.hypot(*body.velocity[:, :2].T) for name, body in run.bodies.items()}


@report_sections
def sections(run, mechanism):
    rows = tuple((name, float(speed.max())) for name, speed in speeds(run).items())
    return [
        Section(
            "house-speeds", "Speeds", tables=(Table("house-speeds", "Speeds", columns_of("body; speed [m/s]"), rows),)
        )
    ]


def charts(run):
    return [chart(run)] if run.records("trajectory/velocity") and run.bodies else []


def chart(run):
    lines = tuple(Line(name, run.time, speed) for name, speed in speeds(run).items())
    return Figure("house-speeds", "Speeds", "Speeds of the bodies.", Axis("time", "s"), Axis("speed", "m/s"), lines)


@table_writer
def write(table, path):
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("| " + " | ".join(column.name for column in (table.first, *table.columns)) + " |\n")
        file.write("|---" * (1 + len(table.columns)) + "|\n")
        for first, others in table.blocks():
            for row in zip(first, *others, strict=True):
                file.write("| " + " | ".join(str(value) for value in row) + " |\n")


@hookimpl
def mbdkit_items():
    return [
        ReportSection(name="house-speeds", summary="Speeds of bodies.", make=Target("house_style:sections")),
        PlotKind(name="house_speeds", summary="speeds of bodies", module="house_style"),
        TableFormat(name="markdown", summary="Tables of Markdown.", suffix=".md", write=Target("house_style:write")),
    ]
