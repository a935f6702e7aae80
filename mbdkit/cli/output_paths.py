"""Where commands write: names by default, and what is refused before any work."""

from __future__ import annotations

import os
from pathlib import Path


def stem(spec: str) -> str:
    """Return the name that results of a spec get by default, without suffix."""
    return "stdin" if spec == "-" else Path(spec).stem


def check_new(path: Path, source: str, overwrite: bool) -> None:
    """Refuse an archive that cannot be written, before any work."""
    from mbdkit.archive.part_file import check_target
    from mbdkit.errors import SpecError

    if source != "-" and os.path.isfile(path) and os.path.isfile(source) and os.path.samefile(path, source):
        raise SpecError(
            "this is what is read here, so it is not written to; choose another name with -o "
            "(and `mbdkit rerun` runs an archive again)",
            file=path,
        )
    if os.path.isfile(path) and not overwrite:
        raise SpecError("this file exists; choose another name with -o, or replace it with --overwrite", file=path)
    check_target(path, overwrite=overwrite)


def check_free(path: Path, source: str, overwrite: bool) -> None:
    """Refuse to write over a file that exists, or over what is read, before any work."""
    from mbdkit.errors import SpecError

    if path.is_dir():
        raise SpecError("this is a folder; name a file", file=path)
    if not path.parent.is_dir():
        raise SpecError(f"the folder {path.parent} does not exist; create it first", file=path)
    if not path.exists():
        return
    if source != "-" and os.path.isfile(source) and os.path.samefile(path, source):
        raise SpecError("this is what is read here, so it is not written to; choose another name", file=path)
    if not overwrite:
        raise SpecError("this file exists; choose another name, or replace it with --overwrite", file=path)
