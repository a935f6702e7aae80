"""`Run.animate`: an animation of a run with controls, for notebooks."""

from __future__ import annotations

import os
from pathlib import Path

from markupsafe import Markup

from mbdkit.archive.result_seams import run_attribute
from mbdkit.archive.run import Run
from mbdkit_report.figures.curves import require_rows
from mbdkit_report.pages.animate import animate, page

_NUMBERS = 150_000  #: Approximate number of pose values in the output of a cell; they take about one megabyte.
#: Style with which the page in the frame follows the light or dark theme of the notebook.
_IN_DARK_THEMES = (
    ".mbdkit-player { color-scheme: light; } "
    ':is([data-jp-theme-light="false"], .vscode-dark) .mbdkit-player { color-scheme: dark; }'
)
_HEIGHT = 640  #: Height of the frame [px].


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
        frame = (
            "<style>{}</style>"
            '<iframe class="mbdkit-player" srcdoc="{}" sandbox="allow-scripts" title="Animation of the run" '
            'loading="lazy" style="width: 100%; max-width: 60rem; height: {}px; border: 0; resize: vertical"></iframe>'
        )
        return str(Markup(frame).format(Markup(_IN_DARK_THEMES), self._page, _HEIGHT))

    def __repr__(self) -> str:
        return f"<Animation of run {self._run.run_id}>"


run_attribute(Animation)
