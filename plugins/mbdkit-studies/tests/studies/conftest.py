"""A small study, and one that has been run."""

from __future__ import annotations

import copy
import shutil
from pathlib import Path
from typing import Any

import pytest

import mbdkit

SMALL: dict[str, Any] = {
    "mbdkit_study": 1,
    "title": "Two methods, two steps",
    "base": {"model": {"name": "double-pendulum"}, "time": {"end": 0.5, "step": 0.02}},
    "axes": [
        {"integrator": [{"name": "rk4"}, {"label": "Gauss 2", "value": {"name": "gauss", "stages": 2}}]},
        {"time.step": [0.02, 0.01]},
    ],
    "reference": {"integrator": {"name": "gauss", "stages": 4}, "time.step": 0.01},
}


@pytest.fixture
def small() -> dict[str, Any]:
    """A study of four runs and a reference, for a test to change."""
    return copy.deepcopy(SMALL)


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> mbdkit.Study:
    """The small study, run by one process; not to be changed."""
    return mbdkit.study(SMALL, out=tmp_path_factory.mktemp("studies") / "small")


@pytest.fixture
def copied(finished: mbdkit.Study, tmp_path: Path) -> Path:
    """A copy of the folder of the finished study, files as old as they are there."""
    return Path(shutil.copytree(finished.folder, tmp_path / "small"))
