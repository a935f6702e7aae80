"""Distributions that are damaged, or take the name of mbdkit, harm neither mbdkit nor the plugins of others."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import mbdkit
from mbdkit.base import distributions
from mbdkit.base.text import message_of, one_line
from mbdkit.engine.native import machine_code
from mbdkit.registry import manager
from mbdkit.registry.catalogue import Registry

Install = Callable[..., None]


def write(site: Path, name: str, points: bytes, metadata: bytes | None = None) -> None:
    """Write the metadata of a distribution, version 1.0, in a folder on the path."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_bytes(metadata or f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n".encode())
    (info / "entry_points.txt").write_bytes(points)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a distribution in a folder that is the first on the path."""
    caches = [distributions.own_version, distributions._own_points]
    caches += [machine_code.kernel_packages, machine_code.own_kernel_packages]
    monkeypatch.syspath_prepend(tmp_path)

    def installed(*given: bytes | str) -> None:
        write(tmp_path, *given)
        forget()

    def forget() -> None:
        manager.forget()
        for cached in caches:
            cached.cache_clear()

    yield installed
    monkeypatch.undo()
    forget()


def failures(loaded: Registry) -> dict[str, str | None]:
    return {report.id: report.error for report in loaded.failures}


WRONG_POINTS = [b"[mbdkit]\nx = caf\xe9\n", b"[mbdkit]\n= = \nx\n", b"[mbdkit.kernels]\nx = caf\xe9\n"]


@pytest.mark.parametrize("points", WRONG_POINTS)
def test_entry_points_that_cannot_be_read_are_a_failure_of_their_distribution(install: Install, points: bytes) -> None:
    install("damaged", points)
    loaded = manager.installed()
    assert len(loaded.only("mbdkit").items) > 50
    assert "its entry points cannot be read" in (failures(loaded)["damaged-1.0.dist-info"] or "")


def test_metadata_that_are_not_utf_8_cost_a_plugin_its_name_only(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "acme_swing.py").write_text(
        "import mbdkit\n\n@mbdkit.hookimpl\ndef mbdkit_models():\n"
        "    return [mbdkit.ModelPlugin('swing', 'A swing', None, lambda options: None)]\n"
    )
    install("acme", b"[mbdkit]\nx = acme_swing\n", b"Metadata-Version: 2.1\nName: acme\nAuthor: Andr\xe9\n")
    assert {report.origin.distribution for report in manager.installed().reports} == {"mbdkit", "acme"}


@pytest.mark.parametrize("name", ["mbdkit", "MBDKit", "harmless"])
def test_another_distribution_that_calls_itself_mbdkit_is_not_imported(
    install: Install, tmp_path: Path, name: str
) -> None:
    version = mbdkit.__version__
    (tmp_path / "impostor.py").write_text("raise SystemExit('imported')")
    install(name, b"[mbdkit]\nbuiltin = impostor\n", b"Metadata-Version: 2.1\nName: mbdkit\nVersion: 99\n")
    loaded = manager.installed()
    assert failures(loaded) == {f"{name}-1.0.dist-info": "it is not mbdkit, but calls itself so"}
    assert "impostor" not in sys.modules
    assert len(loaded.only("mbdkit").items) > 50
    assert mbdkit.__version__ == version


@pytest.mark.parametrize("value", ["missing.kernels", "missing", "json:loads", "..", "", "json.decoder.x"])
def test_wrong_names_of_kernels_of_others_do_not_concern_runs(install: Install, value: str) -> None:
    before, packages = machine_code.code_id(), machine_code.kernel_packages()
    install("foreign", f"[mbdkit.kernels]\nx = {value}\n".encode())
    assert machine_code.code_id() == before
    assert machine_code.kernel_packages() == packages


@pytest.mark.parametrize("raised", [ValueError("no"), SystemExit(5), BaseException("no")])
def test_an_exception_whose_text_raises_has_a_line(raised: BaseException) -> None:
    class SilentError(Exception):
        def __str__(self) -> str:
            raise raised

    assert one_line(SilentError()) == message_of(SilentError()) == "SilentError, whose message cannot be shown"


def test_commands_run_beside_all_of_them(tmp_path: Path) -> None:
    for number, points in enumerate(WRONG_POINTS):
        write(tmp_path, f"damaged{number}", points)
    write(tmp_path, "mbdkit", b"[mbdkit]\nbuiltin = impostor\n")
    write(tmp_path, "foreign", b"[mbdkit.kernels]\nx = tests.missing.kernels\n")
    write(tmp_path, "silent", b"[mbdkit]\nx = silent\n")
    (tmp_path / "silent.py").write_text(
        "class E(Exception):\n    def __str__(self):\n        raise SystemExit(5)\n\nraise E\n"
    )
    command = [sys.executable, "-m", "mbdkit", "run", "pendulum", "--quiet", "--set", "time.end=0.1"]
    for plugins, warnings in ((None, 5), ("", 0)):
        environment = {"PYTHONPATH": str(tmp_path), "PATH": "", **({} if plugins is None else {"MBDKIT_PLUGINS": ""})}
        done = subprocess.run(
            [*command, "--overwrite"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("mbdkit: warning: ") == done.stderr.count("\n") == warnings, done.stderr
