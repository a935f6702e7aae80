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


for _project in sorted(Path(__file__).parent.glob("*/pyproject.toml")):
    _announce(_project.parent)
sys.path.insert(0, _METADATA.name)
