"""What functions of plugins about runs and files of results take and return."""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive.run import Run
from mbdkit.registry.seam import Seam


@Seam
def run_attribute(run: Run, /) -> object:
    """Return the value of an attribute of a run, which the run keeps."""
    raise NotImplementedError


@Seam
def summary_lines(run: Run, /) -> list[tuple[str, str]]:
    """Return lines of the summary of a run, each a label and a text; empty texts are left out."""
    raise NotImplementedError


@Seam
def file_problems(path: Path, /) -> list[str] | None:
    """Return the problems found in a file of results, or None if it is of another kind."""
    raise NotImplementedError


@Seam
def exported_files(folder: Path, output: Path, to: str, /, *, overwrite: bool) -> list[Path]:
    """Write the tables of a folder of results to `output`, in a format such as ``csv``; return the files written."""
    raise NotImplementedError
