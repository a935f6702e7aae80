"""`Run.animate`: an animation of a run with controls, for notebooks."""

from __future__ import annotations

import os
from pathlib import Path

from mbdkit.archive.result_seams import run_attribute
from mbdkit.archive.run import Run
from mbdkit_report.figures.curves import require_rows
from mbdkit_report.pages.animate import animate, page
from mbdkit_report.pages.templating import render

_NUMBERS = 150_000  #: Approximate number of pose values in the output of a cell; they take about one megabyte.


class Animation:
    """The motion of a run with controls for time and speed, and for magnifying the gaps in the joints.

    A notebook shows it as a frame with the page that ``mbdkit animate RUN.h5 -o RUN.html`` writes. The frame may run
    the scripts of this page, but has no access to the notebook and loads no other files.
    """

    def __init__(self, run: Run):
        require_rows(run)
        self._run = run
        self._page = page(run, _NUMBERS)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the animation to a file, and return its path; see `mbdkit_report.pages.animate.animate`.

        Parameters
        ----------
        path
            File to write, ending in .gif, .html or .mp4. An existing file is replaced.
        """
        return animate(self._run, path)

    def _repr_html_(self) -> str:
        return render("frame.html", {"page": self._page})

    def __repr__(self) -> str:
        return f"<Animation of run {self._run.run_id}>"


run_attribute(Animation)
