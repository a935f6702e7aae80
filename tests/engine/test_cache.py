"""The cache of compiled kernels: never stale, written by one process, and not needed for a run to work."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.engine.jit import cache

from .few_kernels import ACCELERATION

TOLD = """
from mbdkit.engine.jit.cache import FOLDER
print(json.dumps({"result": acceleration(), "folder": str(FOLDER), "package": mbdkit.__file__}))
"""

RUN = """\
import json
import mbdkit
from mbdkit.engine.jit.cache import FOLDER

run = mbdkit.run("pendulum", time={"end": 0.02, "step": 0.01}).check()
print(json.dumps({"result": float(run.time[-1]), "folder": str(FOLDER), "package": mbdkit.__file__}))
"""


INCLUDING = """\
from numba import njit
from mbdkit.engine.jit.cache import cached

def double(x):
    return 2.0 * x

kernel = cached(njit(double))
print(kernel(3.0))
print(njit(lambda x: kernel(x) + 1.0)(3.0))
"""
"""Compiles a function that includes a kernel."""


STRANGER = (
    *("setpriv", "--reuid=54321", "--regid=54321", "--clear-groups"),
    *("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"),
)
"""Runs a command as a user without passwd entry, who may read everything, but writes only where all users may."""


def start(program: str, package: Path, folder: Path, *before: str, **variables: str) -> subprocess.Popen[str]:
    """Start a program with the copy of mbdkit in `package`, its cache under `folder`; `before` precedes the command.

    Empty variables are left out of the environment.
    """
    environment = os.environ | {"PYTHONPATH": str(package), "MBDKIT_CACHE_DIR": str(folder)} | variables
    environment = {name: value for name, value in environment.items() if value or name not in variables}
    return subprocess.Popen(
        [*before, sys.executable, "-c", program],
        env=environment,
        cwd=package,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def end(process: subprocess.Popen[str], package: Path) -> tuple[dict[str, Any], str]:
    """Return what the program printed, and its messages."""
    output, messages = process.communicate(timeout=300)
    assert process.returncode == 0, messages
    found = json.loads(output)
    assert Path(found["package"]).is_relative_to(package)
    return found, messages


def copied(to: Path) -> Path:
    source = Path(mbdkit.__file__).parent
    shutil.copytree(source, to / "mbdkit", ignore=shutil.ignore_patterns("__pycache__"))
    return to


def compiled_files(folder: Path) -> dict[str, int]:
    return {str(path): path.stat().st_mtime_ns for path in folder.rglob("*.code")}


@pytest.mark.slow
def test_an_edited_kernel_is_compiled_anew_by_one_process_while_another_waits(tmp_path: Path) -> None:
    # expected: -w^2 r = -2 m/s^2 with the right sign of gamma, 2 m/s^2 with the other one, although the file that calls
    # the edited kernel has not changed
    package = copied(tmp_path / "package")
    kernels = package / "mbdkit" / "engine" / "kernels" / "element_kernels.py"
    text = kernels.read_text()
    begin = text.index("def revolute_acceleration")
    edited = re.sub(r"gamma\[k, 0\] = (.*)", r"gamma[k, 0] = -(\1)", text[begin:], count=1)
    kernels.write_text(text[:begin] + edited)
    folder = tmp_path / "cache"

    started = [start(ACCELERATION + TOLD, package, folder) for _ in range(2)]
    both = [end(process, package) for process in started]
    assert [found["result"] for found, _ in both] == pytest.approx([2.0, 2.0], rel=1e-12)
    messages = sorted(m.count("compiled in") for _, m in both)
    assert messages == [0, 1]
    assert all("once per installation" in m for _, m in both if "compiled in" in m)

    kept = compiled_files(folder)
    assert kept
    assert all(Path(path).is_relative_to(both[0][0]["folder"]) for path in kept)
    assert not list(package.rglob("*.code"))
    again, quiet = end(start(ACCELERATION + TOLD, package, folder), package)
    assert again == both[0][0]
    assert quiet == ""
    assert compiled_files(folder) == kept


def test_a_kernel_from_the_cache_is_not_included_in_another_function_without_its_code(tmp_path: Path) -> None:
    # expected: the files of the cache hold the symbols of a kernel, but not the code that Numba would include
    (tmp_path / "including.py").write_text(INCLUDING)
    environment = os.environ | {"MBDKIT_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "including.py"]
    first, second = (
        subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        for _ in range(2)
    )
    assert first.stdout == "6.0\n7.0\n"
    assert second.stdout == "6.0\n"
    assert "library unfit for linking" in second.stderr


def test_an_unwritable_cache_costs_a_warning_and_not_the_run(tmp_path: Path) -> None:
    # expected: a folder below a regular file cannot be made, whoever asks; what is compiled plays no part in it
    blocked = tmp_path / "file"
    blocked.touch()
    package = copied(tmp_path / "package")
    found, messages = end(start(RUN, package, blocked / "cache", NUMBA_DISABLE_JIT="1"), package)
    assert "cannot be created" in messages
    assert "MBDKIT_CACHE_DIR" in messages
    assert not Path(found["folder"]).exists()  # the temporary folder went with its process
    assert blocked.read_bytes() == b""


@pytest.fixture
def stranger() -> tuple[str, ...]:
    """The words before a command that is run by another user than root."""
    try:
        possible = subprocess.run([*STRANGER, "true"], capture_output=True, check=False).returncode == 0
    except OSError:
        possible = False
    if not possible:
        pytest.skip("needs root, and setpriv, to run a command as a user without passwd entry")
    return STRANGER


@pytest.mark.slow
def test_a_warm_cache_that_cannot_be_written_is_used(tmp_path: Path, stranger: tuple[str, ...]) -> None:
    # expected: -w^2 r = -2 m/s^2, without compilation and without a word
    package, folder = copied(tmp_path / "package"), tmp_path / "cache"
    end(start(ACCELERATION + TOLD, package, folder), package)
    kept = compiled_files(folder)
    found, messages = end(start(ACCELERATION + TOLD, package, folder, *stranger), package)
    assert found["result"] == pytest.approx(-2.0, rel=1e-12)
    assert Path(found["folder"]).is_relative_to(folder)
    assert messages == ""
    assert compiled_files(folder) == kept


def test_a_user_without_home_and_passwd_entry_can_run(tmp_path: Path, stranger: tuple[str, ...]) -> None:
    # expected: a temporary folder in place of the cache; what is compiled plays no part in it
    package = copied(tmp_path / "package")
    nowhere = {"HOME": "", "MBDKIT_CACHE_DIR": "", "XDG_CACHE_HOME": "", "LOCALAPPDATA": ""}
    found, messages = end(start(RUN, package, tmp_path, *stranger, NUMBA_DISABLE_JIT="1", **nowhere), package)
    assert messages.count("the cache folder cannot be created") == 1
    assert "MBDKIT_CACHE_DIR" in messages
    assert not Path(found["folder"]).exists()


def test_the_fingerprint_changes_with_any_kernel_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = copied(tmp_path / "copy") / "mbdkit"
    monkeypatch.setattr(cache, "_PACKAGE", package)
    before = cache.fingerprint()
    sources = cache.kernel_sources()
    names = {path.name for path in sources}
    assert {"element_kernels.py", "schur.py", "lu.py", "system.py", "explicit.py"} <= names
    for path in sources:
        text = path.read_text()
        path.write_text(text + "\n")
        assert cache.fingerprint() != before
        path.write_text(text)
    assert cache.fingerprint() == before


def test_every_compiled_function_lives_in_a_file_that_the_fingerprint_covers() -> None:
    package = Path(mbdkit.__file__).parent
    covered = {path.resolve() for path in cache.kernel_sources()}
    decorated = re.compile(r"^@(kernel|subkernel|inlined|entry)$", re.MULTILINE)
    compiled = {path.resolve() for path in package.rglob("*.py") if decorated.search(path.read_text())}
    assert len(compiled) > 5
    assert compiled <= covered
