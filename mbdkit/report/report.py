"""`report`: a run archive or a study folder as one self-contained page, and its figures as pictures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mbdkit.analysis.verdict import Verdict
from mbdkit.archive.reader import load
from mbdkit.errors import SpecError
from mbdkit.files import check_suffix, replacing
from mbdkit.report.report_page import Document
from mbdkit.report.run_report import run_document
from mbdkit.report.still import still_files, write_stills
from mbdkit.report.verdict_text import markdown

SUFFIXES = (".html", ".htm", ".md")


def report(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    figures: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the report of a run or of a study; see `written`, which returns its verdict as well."""
    return written(path, output, figures=figures, overwrite=overwrite)[0]


def written(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    figures: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> tuple[Path, Verdict]:
    """Write the report of a run or of a study.

    Parameters
    ----------
    path
        A run archive or a study folder.
    output
        The page, ending in .html; left out, ``NAME-report.html`` beside the archive, or ``report.html`` in the folder.
        Ending in .md: verdict, claims and tables alone, in Markdown.
    figures
        Folder for the figures as PNG and SVG. Left out, a run's are not written, and those of a study go to ``figures``
        in its folder if its page goes there too.
    overwrite
        Whether files that exist may be replaced.

    Returns
    -------
    Path, Verdict
        The page, and what it says.

    Raises
    ------
    SpecError
        There is nothing at `path` to report on, or the page or a figure cannot be written; nothing is written then.
    """
    source = Path(path)
    is_study = os.path.isdir(source)
    if output is None:
        target = source / "report.html" if is_study else source.with_name(f"{source.stem}-report.html")
        figures = source / "figures" if is_study and figures is None else figures
    else:
        target = Path(output)
    folder = None if figures is None else Path(figures)
    if not os.path.exists(source):
        raise SpecError("there is no run archive or study folder of this name", file=source)
    _check(target, folder, overwrite)
    with _document(source, is_study) as document:
        page = markdown(document) if target.suffix == ".md" else document.html()
        stands = os.path.isfile(target) and target.read_bytes() == page.encode()
        with replacing(target) as temporary:
            temporary.write_bytes(page.encode())
        drawn = document.verdict.figures
        if folder is not None and not (stands and all(file.exists() for file in still_files(drawn, folder))):
            write_stills(drawn, folder)  # most of the time goes here: pictures of the very same page are kept
    return target, document.verdict


@contextmanager
def _document(source: Path, is_study: bool) -> Iterator[Document]:
    if is_study:
        from mbdkit.report.study_report import study_document
        from mbdkit.studies.study import load_study

        yield study_document(load_study(source))
    else:
        with load(source) as run:
            yield run_document(run)


def _check(target: Path, folder: Path | None, overwrite: bool) -> None:
    """Refuse what cannot be written, before any work."""
    check_suffix(target, SUFFIXES, "a report")
    if os.path.isdir(target):
        raise SpecError("this is a folder; name a file with -o", file=target)
    if not os.path.isdir(target.parent):
        raise SpecError(f"the folder {target.parent} does not exist; create it first", file=target)
    if os.path.lexists(target) and not overwrite:
        raise SpecError("this file exists; choose another name with -o, or replace it with --overwrite", file=target)
    if folder is None:
        return
    if not os.path.lexists(folder):
        if not os.path.isdir(folder.parent):
            raise SpecError(f"the folder {folder.parent} does not exist; create it first", file=folder)
        return
    if not os.path.isdir(folder):
        raise SpecError("this is not a folder; name one for the figures with --figures", file=folder)
    if any(folder.iterdir()) and not overwrite:
        raise SpecError(
            "this folder is not empty; choose another with --figures, or replace the figures of the same names with "
            "--overwrite",
            file=folder,
        )
