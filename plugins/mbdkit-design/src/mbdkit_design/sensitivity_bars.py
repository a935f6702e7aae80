"""Bar charts of the sensitivities of goals and limits at the best point of a design; the side of a bar shows the
sign.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from markupsafe import Markup

from mbdkit_design.landscape import SHARE, Sensitivity
from mbdkit_report import Cell, Column, Illustration, Section, Table, short_name, svg_of

_STEP = 22.0
_TEXT = '<text x="{:.0f}" y="{:.0f}"{}>{}</text>'


def sensitivity_section(
    found: Sequence[Sensitivity], words: Mapping[str, str], units: Mapping[tuple[str, str], str]
) -> Section:
    """Return the section with the bars and their table.

    Parameters
    ----------
    words
        Names of the variables as written in sentences, by name in the spec.
    units
        Units of goals and limits by scenario and name.
    """
    sentence = (
        f"Change of each goal and limit, to first order, if one variable is increased from its best value by "
        f"{100 * SHARE:g} % of the width of its bounds. Where neither bounds nor limits are active, the "
        "changes of a single goal in the scenarios, times their weights, add up to zero for each variable. A goal "
        "whose slope is discontinuous at the best value has two changes, for an increase and for a decrease, and no "
        "bar."
    )
    text = "Changes to the right are increases. Each goal or limit has its own scale."
    drawing = Illustration.of(partial(_svg, found, words, units), text, text)
    return Section("sensitivities", "Sensitivities", (sentence,), drawing, (_table(found, words, units),))


def _name(one: Sensitivity) -> str:
    return f"{one.measure} ({one.scenario})" if one.scenario else one.measure


def _both(one: Sensitivity, name: str) -> str:
    """Return the changes of a measure for an increase and for a decrease of a variable, as text. Both are needed where
    the slope of the measure is discontinuous.
    """
    down, up = one.corners[name]
    return f"{up:+.3g} if increased, {down:+.3g} if decreased"


def _table(found: Sequence[Sensitivity], words: Mapping[str, str], units: Mapping[tuple[str, str], str]) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (
            _name(one),
            units[one.scenario, one.measure],
            *(_both(one, name) if name in one.corners else change for name, change in one.changes.items()),
        )
        for one in found
    ]
    columns = [Column("goal or limit"), Column("unit"), *(Column(words[name]) for name in found[0].changes)]
    return Table("sensitivities-table", "Changes in numbers", tuple(columns), tuple(rows))


def _svg(
    found: Sequence[Sensitivity], words: Mapping[str, str], units: Mapping[tuple[str, str], str], width: float
) -> Markup:
    parts: list[Markup] = []
    y = 8.0
    for one in found:
        unit = units[one.scenario, one.measure]
        title = Markup('<text class="body" x="10" y="{:.0f}">{}</text>')
        parts.append(title.format(y + 12, _name(one) + (f" [{unit}]" if unit else "")))
        y += _STEP
        parts += _bars(one, words, width, y)
        y += _STEP * len(one.changes) * (1 if width > Illustration.NARROW else 2) + 10.0
    return svg_of(parts, width, y)


def _bars(one: Sensitivity, words: Mapping[str, str], width: float, y: float) -> Iterator[Markup]:
    """Yield a bar for each variable, to the left or right by its sign, with name and value, starting at `y` [px]."""
    is_wide = width > Illustration.NARROW
    left, side = (300.0, 80.0) if is_wide else (0.0, 70.0)  # space for the names, and for the numbers on each side
    middle, half = (left + width) / 2, (width - left) / 2 - side
    top = y
    most = max((abs(value) for value in one.changes.values() if np.isfinite(value)), default=0.0) or 1.0
    for name, value in one.changes.items():
        if is_wide:
            yield Markup(_TEXT).format(left - 8, y + 12, Markup(' text-anchor="end"'), short_name(words[name], 44))
        else:
            yield Markup(_TEXT).format(10, y + 12, "", short_name(words[name], 46))
            y += _STEP
        size = half * abs(value) / most if np.isfinite(value) else 0.0
        begin = middle - size if value < 0 else middle
        yield Markup('<rect class="bar" x="{:.1f}" y="{:.1f}" width="{:.1f}" height="14"/>').format(begin, y, size)
        text = f"{value:+.3g}" if np.isfinite(value) else _both(one, name) if name in one.corners else "unknown"
        anchor = Markup(' text-anchor="end"' if value < 0 else "")
        yield Markup(_TEXT).format(middle + (-size - 6 if value < 0 else size + 6), y + 12, anchor, text)
        y += _STEP
    yield Markup('<path class="faint" d="M{0:.1f} {1:.1f}L{0:.1f} {2:.1f}"/>').format(
        middle, top - 3 if is_wide else top + _STEP - 3, y - 3
    )
