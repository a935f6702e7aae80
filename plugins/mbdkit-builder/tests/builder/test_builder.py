"""The builder of machine code: what it is built from, wheels, and that stored code is what it builds."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform, chosen_level, this_platform
from mbdkit_builder import __main__ as builder
from mbdkit_builder import libraries, method_stubs, sources
from mbdkit_builder.__main__ import write_generated
from mbdkit_builder.element_kernels import TARGET, generated
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


@pytest.fixture(scope="module")
def fresh() -> str:
    return generated()


@pytest.mark.slow
def test_the_checked_in_kernels_are_those_that_the_definitions_generate(fresh: str) -> None:
    assert TARGET.read_text(encoding="utf-8") == fresh, "run `python -m mbdkit_builder elements`"


def test_the_checked_in_signatures_are_those_that_the_models_generate() -> None:
    text = method_stubs.generated()
    assert method_stubs.TARGET.read_text(encoding="utf-8") == text, "run `python -m mbdkit_builder methods`"
    assert "angle: float | None = None" in text
    assert "\n            Initial angular velocity [rad/s].\n" in text


def test_check_tells_fresh_kernels_from_stale_ones(fresh: str, tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "element_kernels.py"
    target.write_text(fresh.replace("gx", "gy", 1), encoding="utf-8")
    assert write_generated(target, fresh, check=True) == 1
    assert "element_kernels.py is out of date" in capsys.readouterr().out
    assert write_generated(target, fresh, check=False) == 0
    assert write_generated(target, fresh, check=True) == 0


ROOT = Path(__file__).parents[4]
TAGS = {
    "linux-x86_64": "manylinux2014_x86_64", "linux-aarch64": "manylinux2014_aarch64", "windows-x86_64": "win_amd64",
    "macos-arm64": "macosx_11_0_arm64", "macos-x86_64": "macosx_11_0_x86_64",
}  # fmt: skip


def built(target: Platform, into: Path) -> Path:
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(into), str(ROOT)]
    subprocess.run(command, env=os.environ | {"MBDKIT_WHEEL": str(target)}, check=True)
    (found,) = into.glob("*.whl")
    return found


@pytest.mark.end_to_end
@pytest.mark.parametrize("target", PLATFORMS, ids=str)
def test_a_wheel_has_the_libraries_of_its_platform(target: Platform, tmp_path: Path) -> None:
    if not machine_code.stored_folder(machine_code.CORE, target).is_dir():
        pytest.skip(f"no machine code is stored for {target}")
    wheel = built(target, tmp_path / "first")
    assert wheel.name.endswith(f"-py3-none-{TAGS[str(target)]}.whl")
    if target == next(iter(PLATFORMS)):
        assert wheel.read_bytes() == built(target, tmp_path / "second").read_bytes()
    with zipfile.ZipFile(wheel) as file:
        stored = {name: file.read(name) for name in file.namelist() if "/stored/" in name}
        about = file.read(next(name for name in file.namelist() if name.endswith(".dist-info/WHEEL"))).decode()
    assert "Root-Is-Purelib: false" in about
    expected: dict[str, str] = {}
    for package in machine_code.kernel_packages():
        folder = machine_code.stored_folder(package, target)
        inside = f"{package}/{folder.relative_to(machine_code.folder_of(package)).as_posix()}"
        digests = json.loads((folder / machine_code.MANIFEST).read_bytes())["sha256"]
        expected |= {f"{inside}/{name}": digest for name, digest in digests.items()}
        del stored[f"{inside}/{machine_code.MANIFEST}"]
    assert {name: hashlib.sha256(content).hexdigest() for name, content in stored.items()} == expected
