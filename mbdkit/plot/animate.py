"""`animate`: a run in motion, written to a GIF, an MP4 or an HTML page that works offline."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.files import check_suffix, replacing
from mbdkit.plot.film import write_gif, write_mp4
from mbdkit.plot.series import require_rows
from mbdkit.report.animation_page import write_html

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

WRITERS: dict[str, Callable[[Run, Path], None]] = {".gif": write_gif, ".mp4": write_mp4, ".html": write_html}


def animate(run: Run, path: str | os.PathLike[str]) -> Path:
    """Write a run in motion to a file, which is replaced if it is there.

    Every frame is a recorded row of the run. A GIF or MP4 shows 2 to 16 s in real time; a longer run is made faster and
    a shorter one is slowed down by a round factor, and the picture says so. In a page the reader chooses.

    Parameters
    ----------
    run
        The run.
    path
        File to write; its suffix is the format: .gif, .html (a page with controls that needs no network) or .mp4 (needs
        the program ffmpeg).

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SpecError
        The suffix is unknown, the run has no rows, ffmpeg is needed and not there, or the file cannot be written.
    """
    target = check_suffix(path, tuple(WRITERS), "an animation")
    require_rows(run)
    with replacing(target) as temporary:
        WRITERS[target.suffix.lower()](run, temporary)
    return target
