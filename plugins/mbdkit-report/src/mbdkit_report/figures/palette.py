"""Colours of pictures and pages: the palette, and the colours of bodies and paths."""

from __future__ import annotations

from collections.abc import Sequence

from mbdkit_report.figures.drawing_geometry import Drawing, Trace
from mbdkit_report.figures.page_model import Figure

#: Six colours that colour-blind readers can distinguish (Okabe and Ito, with a darker purple).
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#E69F00", "#56B4E9")
INK, FAINT, GRID, PAPER = "#222222", "#666666", "#E4E4E4", "#FFFFFF"
ALARM, SPRING, MUSCLE = "#B00020", "#7A4FBF", "#C0392B"

#: Colours of the names of elements by their kind; bodies have their own, and other kinds of elements `MUSCLE`.
KIND_COLORS = {"joint": INK, "marker": INK, "force": SPRING}


def color_number(color: str) -> int:
    """Return the index of a colour in the palette; -1 for other colours, which pages show in the colour of text."""
    return PALETTE.index(color) if color in PALETTE else -1


def color_key(color: str) -> str:
    """Return the name of a colour in the style sheet of pages, such as ``c0``; ``ink`` for unknown colours."""
    number = color_number(color)
    return {SPRING: "spring", MUSCLE: "muscle"}.get(color, "ink") if number < 0 else f"c{number}"


def body_colors(drawing: Drawing) -> list[str]:
    """Return a colour for each body: different colours for few links, one colour for many."""
    if len(drawing.links) > len(PALETTE):
        return [INK] * len(drawing.bodies)
    return [PALETTE[link] for link in drawing.link_numbers]


def trace_colors(drawing: Drawing, traces: Sequence[Trace]) -> list[str]:
    """Return a colour for each trace: that of its link if every link has its own colour, otherwise a separate one."""
    owners = [drawing.link_numbers[drawing.owner[trace.point]] for trace in traces]
    if len(drawing.links) <= len(PALETTE) and len(set(owners)) == len(owners):
        return [PALETTE[owner] for owner in owners]
    return [PALETTE[index % len(PALETTE)] for index in range(len(traces))]


def line_styles(chart: Figure) -> list[tuple[str, int]]:
    """Return the colour and the index of the dash pattern of each line.

    Lines of a group share a colour; a line without a group forms its own group. If there are more groups than colours,
    the colours repeat. Lines of the same colour differ in their dash patterns, and so do lines that coincide.
    Emphasized lines have the colour of text.
    """
    groups = dict.fromkeys(line.group or line.label for line in chart.lines if not (line.color or line.is_emphasized))
    colors = {group: PALETTE[index % len(PALETTE)] for index, group in enumerate(groups)}
    rows: list[tuple[str, int]] = []
    for number, line in enumerate(chart.lines):
        color = line.color or (INK if line.is_emphasized else colors[line.group or line.label])
        below = [chart.coincide(other, line) for other in chart.lines[:number]]
        taken = {style for (other, style), hidden in zip(rows, below, strict=True) if other == color or hidden}
        rows.append((color, next(style for style in range(len(rows) + 1) if style not in taken)))
    return rows
