"""Output files of commands: default names, and checks before any work."""

from __future__ import annotations

import os
from pathlib import Path


def stem(spec: str) -> str:
    """Return the default name of results of a spec, without suffix."""
    return "stdin" if spec == "-" else Path(spec).stem


def check_new(path: Path, source: str, overwrite: bool) -> None:
    """Raise SpecError if an archive cannot be written."""
    from mbdkit.archive.part_file import check_target
    from mbdkit.errors import SpecError

    if source != "-" and os.path.isfile(path) and os.path.isfile(source) and os.path.samefile(path, source):
        raise SpecError(
            "this file is the input, which is not overwritten; choose another name with -o "
            "(and `mbdkit rerun` runs an archive again)",
            file=path,
        )
    if os.path.isfile(path) and not overwrite:
        raise SpecError("this file exists; choose another name with -o, or replace it with --overwrite", file=path)
    check_target(path, overwrite=overwrite)


def check_free(path: Path, source: str, overwrite: bool) -> None:
    """Raise SpecError if a file cannot be written, exists, or is the input."""
    from mbdkit.errors import SpecError

    if path.is_dir():
        raise SpecError("this is a folder; name a file", file=path)
    if not path.parent.is_dir():
        raise SpecError(f"the folder {path.parent} does not exist; create it first", file=path)
    if not path.exists():
        return
    if source != "-" and os.path.isfile(source) and os.path.samefile(path, source):
        raise SpecError("this file is the input, which is not overwritten; choose another name", file=path)
    if not overwrite:
        raise SpecError("this file exists; choose another name, or replace it with --overwrite", file=path)
