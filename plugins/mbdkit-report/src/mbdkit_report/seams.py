"""What functions of plugins about pages, tables and notebooks take and return."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from mbdkit.archive.run import Run
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.seam import Seam
from mbdkit_report.figures.page_model import Figure, Section

if TYPE_CHECKING:
    from mbdkit_report.pages.report_page import ReportPage


@Seam
def report_sections(run: Run, mechanism: Mechanism | None, /) -> Iterable[Section]:
    """Return sections of the report of a run; the mechanism is None if it cannot be built."""
    raise NotImplementedError


@Seam
def report_charts(run: Run, /) -> Iterable[Figure]:
    """Return charts of the report of a run."""
    raise NotImplementedError


@Seam
def film_data(run: Run, film: dict[str, object], /) -> dict[str, object]:
    """Return the data of the player of a run with additions."""
    raise NotImplementedError


@Seam
def report_of_folder(path: Path, workers: int, /) -> AbstractContextManager[ReportPage]:
    """Return a context that yields the report on a folder or a file of results, made with a number of processes."""
    raise NotImplementedError
