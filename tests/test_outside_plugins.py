"""Plugins in the manner of strangers, in `outside_plugins`: every role, by public names alone, and two that are wrong.

Each is a project of its own. It is copied, put on the path with the metadata of an installation, verified by the
command that its author would type, and used.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import pytest

from tests.installing import install_project, python
from tests.slow_cases import slow_but

pytestmark = pytest.mark.end_to_end
PROJECTS = sorted(path.parent for path in Path(__file__).with_name("outside_plugins").glob("*/pyproject.toml"))
ORDERS = {"adams-two": 2, "kick-drift": 1, "ralston-kit": 3, "rosenbrock-two": 2}
"""Orders of the methods with fixed steps, from the literature that they cite."""
OTHERS = (
    "fung-tissue", "maxwell-strut", "parabola-pin", "path-length", "scipy-rk23", "trammel",
)  # fmt: skip
"""Other projects with items whose evidence is recorded."""
WRONG = {"wrong-weight": ("order: forced pendulum", 4), "wrong-inside": ("order of dense output", 2)}
"""Wrong methods: the column of the matrix that shows it, and the order that they claim."""

SWING = {"mbdkit": 1, "model": {"name": "single-pendulum"}, "time": {"end": 0.5, "step": 0.005}}

Call = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with copies of all projects, and their metadata in `site`."""
    folder = tmp_path_factory.mktemp("outside")
    for project in PROJECTS:
        shutil.copytree(project, folder / project.name, ignore=shutil.ignore_patterns("__pycache__"))
        install_project(folder / "site", folder / project.name)
    return folder


@pytest.fixture
def call(folder: Path) -> Call:
    """Return a function that runs Python with all projects on its path."""
    path = (folder / "site", *(folder / project.name for project in PROJECTS))
    return lambda *words: python(*words, path=path, cwd=folder, MBDKIT_STRICT_PLUGINS="1")


def row_of(name: str, folder: Path, call: Call, status: int) -> dict[str, str]:
    """Record the evidence of a distribution, draw the matrix of all plugins, and return the row of its first item."""
    done = call("-m", "mbdkit", "plugins", "verify", name, "--quick", "--record")
    assert done.returncode == status, done.stdout + done.stderr
    drawn = call("-m", "mbdkit", "plugins", "matrix", "-o", "matrix", "--overwrite")
    assert drawn.returncode == 0, drawn.stderr
    rows = csv.DictReader((folder / "matrix" / "matrix.csv").read_text(encoding="utf-8").splitlines())
    return next(row for row in rows if row["id"].startswith(f"{name}:"))


def test_their_own_tests_pass_and_the_doctor_is_content(folder: Path, call: Call) -> None:
    words = ("-q", "-x", "--import-mode=importlib", "-k", "not conforms", "-p", "no:cacheprovider")
    done = call("-m", "pytest", *words, *(str(folder / project.name) for project in PROJECTS))
    assert done.returncode == 0, done.stdout
    doctor = call("-m", "mbdkit", "plugins", "doctor")
    assert doctor.returncode == 0, doctor.stderr
    loaded = {line.split()[0] for line in doctor.stdout.splitlines() if re.search(r": (\d+) of \1 loaded", line)}
    assert {project.name for project in PROJECTS} <= loaded
    assert "clash" not in doctor.stdout


@pytest.mark.parametrize("name", slow_but([*ORDERS, *OTHERS], "parabola-pin", "ralston-kit", "path-length"))
def test_what_is_promised_is_verified_by_one_command_and_drawn(name: str, folder: Path, call: Call) -> None:
    row = row_of(name, folder, call, status=0)
    assert row["status"].startswith("verified: by mbdkit")
    if name in ORDERS:
        assert float(row["order: forced pendulum"]) == pytest.approx(ORDERS[name], abs=0.2)


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_method_has_its_wrong_order_in_the_matrix_and_runs_that_are_doubtful(
    name: str, folder: Path, call: Call
) -> None:
    column, claimed = WRONG[name]
    row = row_of(name, folder, call, status=1)
    assert row["status"].startswith("failed: ")
    assert float(row[column]) < claimed - 0.5
    method, archive = row["id"], folder / f"{name}.h5"
    (folder / "spec.json").write_text(json.dumps(SWING | {"integrator": {"name": method}}), encoding="utf-8")
    done = call("-m", "mbdkit", "run", "spec.json", "-o", str(archive))
    assert done.returncode == 0, done.stderr
    with h5py.File(archive) as file:
        assert (file.attrs["verdict"], file.attrs["method_evidence"]) == ("doubtful", "failed")
        assert file.attrs["verdict_reasons"][0].startswith(f"method-evidence: the method {method} failed its checks")
