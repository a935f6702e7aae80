"""`plot`: one figure of a run, written to a PNG, SVG or PDF file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from mbdkit.errors import SpecError
from mbdkit.files import check_suffix
from mbdkit.plot.curves import drift_figure, energy_figure, reactions_figure
from mbdkit.plot.series import require_rows
from mbdkit.plot.style import FORMATS, save
from mbdkit.plot.trajectory import trajectory_figure

if TYPE_CHECKING:
    from mbdkit.archive.run import Run

KINDS: dict[str, Callable[[Run], Figure]] = {
    "trajectory": trajectory_figure,
    "drift": drift_figure,
    "energy": energy_figure,
    "reactions": reactions_figure,
}


def figure(run: Run, kind: str = "trajectory") -> Figure:
    """Return one figure of a run, for use where it is not to be written to a file.

    Parameters
    ----------
    run
        The run.
    kind
        ``trajectory``, ``drift``, ``energy`` or ``reactions``.

    Raises
    ------
    SpecError
        There is no such kind, or the run has no rows.
    MbdkitError
        The run did not record what is needed.
    """
    if kind not in KINDS:
        raise SpecError(f"there is no kind of plot {kind!r}; there are {', '.join(KINDS)}")
    require_rows(run)
    return KINDS[kind](run)


def plot(run: Run, kind: str, path: str | os.PathLike[str]) -> Path:
    """Write one figure of a run to a file, which is replaced if it is there.

    Parameters
    ----------
    run
        The run.
    kind
        ``trajectory`` (paths of free ends and moving joints, first and last pose), ``drift`` (misalignment of the
        joints on a logarithmic axis), ``energy`` (with its balance) or ``reactions`` (of the joints).
    path
        File to write; its suffix, .png, .svg or .pdf, is the format.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    SpecError
        The kind or the suffix is unknown, the run has no rows, or the file cannot be written.
    MbdkitError
        The run did not record what is needed.
    """
    target = check_suffix(path, FORMATS, "a plot")
    save(figure(run, kind), target)
    return target
