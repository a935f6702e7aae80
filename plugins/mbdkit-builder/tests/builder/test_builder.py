"""The builder of machine code: what it is built from, and that stored code is compared with what it builds."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform, chosen_level, this_platform
from mbdkit_builder import __main__ as builder
from mbdkit_builder import libraries, sources
from tests.engine.hashed_runs import SPECS, hashes, stored

LEVEL = "x86-64-v3"


@pytest.mark.parametrize("target", PLATFORMS, ids=str)
def test_the_stored_code_is_that_of_this_builder_and_of_the_sources(target: Platform) -> None:
    # expected: an edit of a kernel, of the builder or of imports without a new build is noticed
    outdated = "build the machine code again: python -m mbdkit_builder build --all"
    assert len(machine_code.kernel_packages()) > 1
    for package in machine_code.kernel_packages():
        path = machine_code.stored_folder(package, target) / machine_code.MANIFEST
        manifest = json.loads(path.read_text(encoding="utf-8"))
        assert manifest["files"] == {name: machine_code.digest(name) for name in manifest["names"]}, outdated
        assert manifest["builder"] == sources.builder_digests(), outdated
        for module, numbers in manifest["modules"].items():
            assert tuple(manifest["names"][i] for i in numbers) == sources.files_behind(module), outdated


@stored
@pytest.mark.parametrize("level", [None, LEVEL])
@pytest.mark.parametrize(
    ("key", "name"),
    [
        (None, ""),
        ("builder", "lane_types.py"),
        ("files", "integrators/loop/step_loop.py"),
        ("files", "engine/native/kernel.py"),
    ],
)
def test_check_names_a_manifest_of_other_sources(
    level: str | None, key: str | None, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def build(package: str, folders: Mapping[Platform, Path], *, only: str | None) -> None:
        ((target, into),) = folders.items()
        shutil.copytree(machine_code.STORED / str(target), into)
        path = into / machine_code.MANIFEST
        text = json.loads(path.read_bytes())
        if key:
            text[key][name] = "another"
            path.write_text(json.dumps(text), encoding="utf-8")

    monkeypatch.setattr(builder, "_build", build)
    status = builder._check("mbdkit", [this_platform()], level)
    text = capsys.readouterr().out
    assert (status, text.rpartition(" ")[2]) == ((1, f"{this_platform()}/manifest.json\n") if key else (0, "byte\n"))


def test_check_of_a_level_that_no_platform_has_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert builder._check("mbdkit", [Platform("linux", "aarch64")], "x86-64-v3") == 2
    assert capsys.readouterr().out == "none of these platforms has a level x86-64-v3\n"


def test_what_was_built_by_another_builder_is_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    before = libraries.built_path("motions__motions_at", chosen_level())
    sources.fingerprint.cache_clear()
    digests = {**sources.builder_digests(), "lane_types.py": "another"}
    monkeypatch.setattr(sources, "builder_digests", lambda: digests)
    try:
        assert libraries.built_path("motions__motions_at", chosen_level()) != before
    finally:
        sources.fingerprint.cache_clear()


@stored
@pytest.mark.slow
def test_code_compiled_here_agrees_with_the_stored_code_to_the_bit() -> None:
    pytest.importorskip("ziglang")
    some = {name: SPECS[name] for name in ("double-pendulum rk4", "knee radau-iia")}
    assert hashes(some, without_numba=False, MBDKIT_JIT="1") == hashes(some)


def test_functions_are_not_simplified_for_the_processor_of_this_machine() -> None:
    pytest.importorskip("numba")
    program = (
        "from mbdkit_builder.implementation import dispatcher\n"
        "f = dispatcher(lambda x: x + 1)\n"
        "f.compile('(f8,)')\n"
        "print(f.targetctx.codegen()._tm_features or 'none', f.targetctx.codegen()._get_host_cpu_name())"
    )
    environment = os.environ | {"NUMBA_CPU_NAME": "znver3", "NUMBA_CPU_FEATURES": "+avx2"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["none", "generic"], done.stderr
