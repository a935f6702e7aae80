"""`animate`: an animation of a run as GIF, MP4 or self-contained HTML page."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.base.files import check_suffix, replacing
from mbdkit_report.figures.curves import require_rows
from mbdkit_report.figures.player_data import film_data
from mbdkit_report.pages.templating import render
from mbdkit_report.plot.caption import caption
from mbdkit_report.plot.film import write_gif, write_mp4

if TYPE_CHECKING:
    from mbdkit.archive.run import Run


def animate(run: Run, path: str | os.PathLike[str]) -> Path:
    """Write an animation of a run to a file and return the path of the file. An existing file is replaced.

    Every frame is a recorded row of the run. A GIF or MP4 shows runs of 2 to 16 s in real time. Longer runs are
    accelerated and shorter ones are slowed down by a round factor, which the animation states. On an HTML page the
    reader sets the speed.

    Parameters
    ----------
    path
        File to write. Its suffix selects the format: .gif, .html (a page with controls) or .mp4 (needs the program
        ffmpeg).

    Raises
    ------
    SpecError
        If the suffix is unknown, the run has no rows, ffmpeg is needed but not installed, or the file cannot be
        written.
    """
    target = check_suffix(path, tuple(WRITERS), "an animation")
    require_rows(run)
    with replacing(target) as temporary:
        WRITERS[target.suffix.lower()](run, temporary)
    return target


def page(run: Run, numbers: int = 450_000) -> str:
    """Return the page of a run, with about `numbers` pose values. Each takes six bytes; the default amounts to about
    three megabytes.
    """
    return render("animation.html", {"caption": caption(run), "films": [film_data(run, numbers)]})


WRITERS: dict[str, Callable[[Run, Path], object]] = {
    ".gif": write_gif,
    ".mp4": write_mp4,
    ".html": lambda run, target: target.write_text(page(run), encoding="utf-8", newline="\n"),
}
