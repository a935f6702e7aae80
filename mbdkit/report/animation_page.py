"""Animation of a run as a self-contained HTML page with a canvas."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.figures.player_data import film_data
from mbdkit.plot.caption import caption
from mbdkit.report.templating import render

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

_NUMBERS = 450_000  # pose values in a page, about three megabytes


def write_html(run: Run, target: Path) -> None:
    """Write the page of a run."""
    target.write_text(page(run), encoding="utf-8")


def page(run: Run, numbers: int = _NUMBERS) -> str:
    """Return the page of a run.

    Parameters
    ----------
    numbers
        Approximate number of pose values in it, six bytes each.
    """
    return render("animation.html", {"caption": caption(run), "films": [film_data(run, numbers)]})
