"""Lets the tests of a plugin run in a clone of the repository in the same way as where the plugin is installed."""

from __future__ import annotations

import sys
import tempfile
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_METADATA = tempfile.TemporaryDirectory()


def _announce(folder: Path) -> None:
    """Put a distribution that is not installed on the path, together with the metadata that an installation would
    write.
    """
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    name, number = project["name"], project["version"]
    try:
        version(name)
    except PackageNotFoundError:
        info = Path(_METADATA.name) / f"{name.replace('-', '_')}-{number}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {number}\n", encoding="utf-8")
        points = "\n".join(f"{key} = {value}" for key, value in project["entry-points"]["mbdkit"].items())
        (info / "entry_points.txt").write_text(f"[mbdkit]\n{points}\n", encoding="utf-8")
        sys.path.insert(0, str(folder / "src"))


_ANNOUNCED: set[Path] = set()


def pytest_collect_file(file_path: Path) -> None:
    """Announce a distribution when its tests are collected; tests of mbdkit and its parts see none."""
    here = Path(__file__).parent
    folder = here / file_path.relative_to(here).parts[0]
    if folder not in _ANNOUNCED and (folder / "pyproject.toml").is_file():
        _ANNOUNCED.add(folder)
        _announce(folder)
        if _METADATA.name not in sys.path:
            sys.path.insert(0, _METADATA.name)
