"""Distributions that are installed for one test alone: metadata in a folder that goes on the path."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

from tests.zygote import run_mbdkit


def announce(
    site: Path, name: str, entry_points: dict[str, str], version: str = "1.0", requires: tuple[str, ...] = ()
) -> None:
    """Write the metadata that an installation of a distribution would write."""
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    stated = "".join(f"Requires-Dist: {text}\n" for text in requires)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n{stated}")
    lines = "\n".join(f"{key} = {value}" for key, value in entry_points.items())
    (info / "entry_points.txt").write_text(f"[mbdkit]\n{lines}\n")


def install_module(site: Path, name: str, code: str, version: str = "1.0", requires: tuple[str, ...] = ()) -> None:
    """Install a distribution of one module, whose entry point is `main`."""
    module = name.replace("-", "_")
    site.mkdir(exist_ok=True)
    (site / f"{module}.py").write_text(code, encoding="utf-8")
    announce(site, name, {"main": module}, version, requires)


def install_project(site: Path, folder: Path) -> None:
    """Install a project with its code in ``src``, as ``pip install -e`` would."""
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    requires = tuple(project.get("dependencies", ()))
    announce(site, project["name"], project["entry-points"]["mbdkit"], project["version"], requires)


def python(*arguments: str, path: tuple[Path, ...], cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python with these folders first on its path; ``-m mbdkit`` in a fork that has imported mbdkit already."""
    folders = [*map(str, path), *filter(None, [os.environ.get("PYTHONPATH")])]
    if arguments[:2] == ("-m", "mbdkit"):
        variables = os.environ | {"PYTHONPATH": os.pathsep.join(folders)} | environment
        return run_mbdkit(arguments[2:], path, cwd, variables)
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(folders)} | environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
