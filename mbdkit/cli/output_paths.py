"""Output files of commands: default names, and the check of a new archive before any work."""

from __future__ import annotations

from pathlib import Path


def stem(spec: str) -> str:
    """Return the default name of results of a spec, without suffix."""
    return "stdin" if spec == "-" else Path(spec).stem


def check_new(path: Path, source: str, overwrite: bool) -> None:
    """Raise SpecError if an archive cannot be written."""
    from mbdkit.archive.part_file import check_target

    check_target(path, overwrite=overwrite, source=source)
