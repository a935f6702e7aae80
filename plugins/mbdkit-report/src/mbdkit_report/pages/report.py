"""`report`: write the report of a run or of other results as one self-contained page, and its charts as images."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import cast

from mbdkit.archive.hdf5_errors import DAMAGE
from mbdkit.archive.reader import load
from mbdkit.archive.untrusted_file import open_hdf5
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.files import check_output, check_suffix, replacing
from mbdkit.base.text import listed
from mbdkit.registry.feature_items import FileFormat
from mbdkit.registry.manager import registry
from mbdkit_report.analysis.verdict import Verdict
from mbdkit_report.pages.report_page import ReportPage
from mbdkit_report.pages.run_report import run_report
from mbdkit_report.pages.verdict_text import markdown_text
from mbdkit_report.plot.charts import image_files, write_chart_images
from mbdkit_report.seams import report_of_folder

SUFFIXES = (".html", ".htm", ".md")


def report(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    figures: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the report of a run or of other results, and return the path of the page; see `write_report`."""
    return write_report(path, output, figures=figures, overwrite=overwrite)[0]


def write_report(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    figures: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    workers: int = 1,
) -> tuple[Path, Verdict]:
    """Write the report of a run, study, design or identification, and return its path and the verdict.

    Parameters
    ----------
    path
        A run archive, the result of an identification, or the folder of a study or of a design.
    output
        Path of the page, ending in .html, .htm or .md; by default ``NAME-report.html`` beside the archive, or
        ``report.html`` in the folder. A page that ends in .md contains the verdict, the claims and the tables as
        Markdown.
    figures
        Folder for the charts as PNG and SVG. By default the charts of a run or design are not written; those of a study
        are written to ``figures`` in its folder, unless `output` is given.
    overwrite
        Whether existing files may be replaced.
    workers
        Number of processes that evaluate points around the best point of a design.

    Raises
    ------
    SpecError
        If `path` does not exist, or is a folder without a study or design; if a run has no rows; if `output` does not
        end in .html, .htm or .md; or if the page or a chart cannot be written, for example because it exists and
        `overwrite` is false. The paths are checked before the first file is written.
    """
    source = Path(path)
    is_folder = os.path.isdir(source)
    kind = FileFormat.of_folder(source, _formats()) if is_folder else _of_file(source)
    if output is None:
        target = source / "report.html" if is_folder else source.with_name(f"{source.stem}-report.html")
        if kind is not None and kind.saves_figures and figures is None:
            figures = source / "figures"
    else:
        target = Path(output)
    folder = None if figures is None else Path(figures)
    if not os.path.exists(source):
        raise SpecError("there is no run archive, and no folder of a study or design, of this name", file=source)
    check_suffix(target, SUFFIXES, "a report")
    check_output(target, overwrite=overwrite, source=source)
    _check_figures(folder, overwrite)
    with _document(source, kind, workers) as document:
        page = markdown_text(document) if target.suffix == ".md" else document.html()
        stands = os.path.isfile(target) and target.read_bytes() == page.encode()
        with replacing(target, overwrite=overwrite, source=source) as temporary:
            temporary.write_bytes(page.encode())
        drawn = document.verdict.figures
        # Drawing the images is slow. It is skipped if the page is unchanged and all images exist.
        if folder is not None and not (stands and all(file.exists() for file in image_files(drawn, folder))):
            write_chart_images(drawn, folder)
    return target, document.verdict


def _formats() -> list[FileFormat]:
    formats = [cast(FileFormat, item.plugin) for item in registry().of_kind("file-format")]
    return [one for one in formats if one.report is not None]


def _of_file(source: Path) -> FileFormat | None:
    """Return the format of an HDF5 file that is no run archive; None if it is of no known kind, or cannot be read."""
    if os.path.isfile(source):
        with suppress(MbdkitError, *DAMAGE), open_hdf5(source, "run archive") as file:
            kind = str(file.attrs.get("format"))
            return next((one for one in _formats() if one.format and one.format == kind), None)
    return None


@contextmanager
def _document(source: Path, kind: FileFormat | None, workers: int) -> Iterator[ReportPage]:
    if kind is None and not os.path.isdir(source):
        with load(source) as run:
            yield run_report(run)
    elif kind is None or kind.report is None:
        folders = [one for one in _formats() if one.file]
        phrases = listed([f"no {folder.name}" for folder in folders], "and")
        files = ", ".join(f"no {folder.file}" for folder in folders)
        raise SpecError(f"this folder contains {phrases}: {files}", file=source)
    else:
        with report_of_folder.of(kind.report)(source, workers) as page:
            yield page


def _check_figures(folder: Path | None, overwrite: bool) -> None:
    if folder is None:
        return
    if not os.path.lexists(folder):
        if not os.path.isdir(folder.parent):
            raise SpecError(f"the folder {folder.parent} does not exist; create it first", file=folder)
        return
    if not os.path.isdir(folder):
        raise SpecError("this is not a folder; choose a folder for the figures with --figures", file=folder)
    if any(folder.iterdir()) and not overwrite:
        raise SpecError(
            "this folder is not empty; choose another with --figures, or replace the figures of the same names with "
            "--overwrite",
            file=folder,
        )
