"""The stored machine code: it belongs to the sources, all levels of processors agree to the bit, without Numba."""

from __future__ import annotations

import json
import lzma
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbdkit.base.errors import MbdkitError
from mbdkit.engine.kernels.motions import motions_at
from mbdkit.engine.native import levels as levels_module
from mbdkit.engine.native import machine_code
from mbdkit.engine.native.bundle import array_words
from mbdkit.engine.native.levels import Platform, chosen_level, is_able, this_platform
from tests.benchmarks.bits_settings import settings
from tests.engine.hashed_runs import SHORT, SPECS, hashes, stored

FORMULAS: dict[str, Any] = {
    "slider-crank rk-gill": SHORT | {"integrator": {"name": "rk-gill"}},
    "slider-crank-clearance dopri5": SHORT | {"integrator": {"name": "dopri5", "adaptive": True, "rtol": 1e-6}},
    "crank-press gauss": SHORT | {"integrator": {"name": "gauss", "stages": 2}},
    "squat gauss": SHORT | {"integrator": {"name": "gauss", "stages": 2}},
}
"""Models whose parts are placed by sines and lengths, with expressions, a table, muscles and contact."""
LOOPS: dict[str, Any] = {
    "slider-crank rk-gill": {"time": {"end": 0.1, "step": 0.01}},
    "watt-six-bar gauss": SHORT | {"integrator": {"name": "gauss", "stages": 3}},
    "n-four-bar radau-iia": SHORT | {"integrator": {"name": "radau-iia"}},
}
"""Mechanisms with loops, some redundant, and methods whose stages are transformed by eigenvectors."""
MODELS = LOOPS | FORMULAS


@stored
def test_the_stored_code_is_that_of_the_sources() -> None:
    # expected: an edit of a kernel without a new build is noticed for every symbol that it concerns
    symbols = [
        symbol for package in machine_code.kernel_packages() for symbol in machine_code.manifest(package)["symbols"]
    ]
    outdated = [symbol for symbol in symbols if not machine_code.stored_file(symbol, chosen_level())]
    assert len(symbols) > 60
    assert not outdated, "build the machine code again: python -m mbdkit_builder build"


@pytest.mark.slow
@stored
def test_all_levels_and_the_sources_in_python_agree_to_the_bit() -> None:
    levels = [level.name for level in this_platform().levels if is_able(level)]
    assert len(levels) > 1
    specs = SPECS | {"slider-crank rk-gill": FORMULAS["slider-crank rk-gill"]}
    found = [hashes(specs, MBDKIT_PROCESSOR=level) for level in levels]
    assert all(one == found[0] for one in found)
    some = {name: specs[name] for name in ("double-pendulum rk4", "knee scipy", "slider-crank rk-gill")}
    assert hashes(some, MBDKIT_KERNELS="python") == {name: found[0][name] for name in some}


@pytest.mark.slow
@stored
def test_results_do_not_depend_on_the_level_and_the_routines_that_libraries_choose_for_a_processor() -> None:
    # expected: results of the best level with this processor's own routines; with those of another one, LAPACK, BLAS,
    # and functions of NumPy and of the C library (glibc; others ignore its setting) round differently
    other = {"OPENBLAS_CORETYPE": "Nehalem", **settings()["NumPy"], **settings()["C library"]}
    assert hashes(MODELS, MBDKIT_PROCESSOR=this_platform().levels[-1].name, **other) == hashes(MODELS)


@pytest.fixture
def library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, bytes, str]:
    """A copy of a stored library: its path without ``.xz``, its content and its digest; `BUILT` is an empty folder."""
    folder = machine_code.STORED / str(this_platform())
    packed = next(folder.glob("core-*.xz"))
    shutil.copy(packed, tmp_path)
    monkeypatch.setattr(machine_code, "BUILT", tmp_path / "built")
    content = lzma.decompress(packed.read_bytes())
    return tmp_path / packed.stem, content, machine_code.manifest()["sha256"][packed.stem]


@stored
@pytest.mark.parametrize("is_packed", [True, False])
def test_a_damaged_library_is_refused(is_packed: bool, library: tuple[Path, bytes, str]) -> None:
    path, content, digest = library
    file = path.with_name(f"{path.name}.xz") if is_packed else path
    damaged = bytearray(file.read_bytes() if is_packed else content)
    damaged[len(damaged) // 2] ^= 1
    file.write_bytes(damaged)
    with pytest.raises(MbdkitError, match=rf"{file.name} is damaged: install mbdkit again"):
        machine_code._loaded(path, digest)


@stored
def test_a_library_of_a_wheel_is_loaded_in_place(library: tuple[Path, bytes, str]) -> None:
    path, content, digest = library
    path.write_bytes(content)
    assert machine_code._loaded(path, digest)._name == str(path)
    assert not machine_code.BUILT.exists()


@stored
def test_without_files_in_memory_a_library_is_unpacked_once(
    library: tuple[Path, bytes, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, content, digest = library
    monkeypatch.delattr(os, "memfd_create")
    machine_code.BUILT.mkdir()
    old = machine_code.BUILT / f"{path.stem}-0123456789abcdef{path.suffix}"
    old.touch()
    unpacked = Path(machine_code._loaded(path, digest)._name)
    assert unpacked.read_bytes() == content
    assert os.listdir(machine_code.BUILT) == [unpacked.name]  # an older one is removed
    path.with_name(f"{path.name}.xz").unlink()
    assert machine_code._loaded(path, digest)._name == str(unpacked)
    unpacked.write_bytes(b"damaged")
    with pytest.raises(FileNotFoundError):  # it is unpacked again
        machine_code._loaded(path, digest)


def test_flags_of_macos_have_the_names_of_linux() -> None:
    # expected: a Haswell of 2013, as `sysctl machdep.cpu` of macOS prints it, has all instructions of x86-64-v3
    text = (
        "fpu vme de pse tsc msr pae mce cx8 apic sep mtrr pge mca cmov pat pse36 clfsh ds acpi mmx fxsr sse sse2 ss "
        "htt tm pbe sse3 pclmulqdq dtes64 mon dscpl vmx smx est tm2 ssse3 fma cx16 tpr pdcm sse4_1 sse4_2 x2apic "
        "movbe popcnt aes pcid xsave osxsave seglim64 tsctmr avx1_0 rdrand f16c rdwrfsgs tsc_thread_offset bmi1 avx2 "
        "smep bmi2 erms invpcid syscall xd 1gbpage em64t lahf lzcnt rdtscp tsci"
    )
    levels = {level.name: level.needs <= levels_module.flags_in(text) for level in Platform("linux", "x86_64").levels}
    assert levels == {"x86-64-v4": False, "x86-64-v3": True, "x86-64-v2": True}


@pytest.mark.parametrize(
    ("system", "machine", "name", "levels"),
    [
        ("linux", "x86_64", "linux-x86_64", ["x86-64-v4", "x86-64-v3", "x86-64-v2"]),
        ("linux", "aarch64", "linux-aarch64", ["armv8"]),
        ("darwin", "arm64", "macos-arm64", ["apple"]),
        ("darwin", "x86_64", "macos-x86_64", ["x86-64-v3", "x86-64-v2"]),
        ("win32", "AMD64", "windows-x86_64", ["x86-64-v3", "x86-64-v2"]),
        ("win32", "ARM64", "windows-aarch64", []),
    ],
)
def test_platforms_and_their_levels(
    system: str, machine: str, name: str, levels: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # expected: `sys.platform` and `platform.machine()` as Python's documentation and its builds for these systems say
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    found = this_platform()
    assert (str(found), [level.name for level in found.levels]) == (name, levels)


def test_an_untested_platform_is_named_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(machine_code, "BUILT", tmp_path / "built")
    monkeypatch.setattr(machine_code, "this_platform", lambda: Platform("macos", "arm64"))
    say = machine_code._say_whether_untested.__wrapped__
    say()
    assert "mbdkit has never been tested on macos-arm64" in capsys.readouterr().err
    say()
    assert capsys.readouterr().err == ""
    assert machine_code.code_text().endswith("mbdkit has never been tested on this platform")
    monkeypatch.setattr(machine_code, "BUILT", tmp_path / "no" / "built")  # cannot be created: said again
    say()
    assert "macos-arm64" in capsys.readouterr().err


@pytest.mark.parametrize("damage", [b"[]", b"{}", b"\xff\xfe", b"cut", b"symbols", b"sha256"])
def test_a_damaged_manifest_is_reported(damage: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / str(this_platform())
    folder.mkdir()
    content = (machine_code.STORED / str(this_platform()) / machine_code.MANIFEST).read_bytes()
    if damage == b"cut":
        damage = content[: len(content) // 2]
    elif damage in (b"symbols", b"sha256"):  # entries are missing
        damage = json.dumps({**json.loads(content), damage.decode(): {"motions__motions_at": [1, "?"]}}).encode()
    (folder / machine_code.MANIFEST).write_bytes(damage)
    monkeypatch.setattr(machine_code, "STORED", tmp_path)
    caches = (machine_code.manifest, machine_code._load_stored)
    for one in caches:
        one.cache_clear()
    try:
        with pytest.raises(MbdkitError, match=r"manifest\.json, is damaged: install mbdkit again"):
            machine_code.address_of("motions__motions_at")
    finally:
        for one in caches:
            one.cache_clear()


@pytest.mark.parametrize(
    ("platform", "told"),
    [
        (Platform("plan9", "sparc"), r"there is no machine code for plan9-sparc, only for linux-x86_64, linux-aarch64"),
        (Platform("linux", "x86_64"), r"no machine code for linux-x86_64: install a wheel for this platform"),
    ],
)
def test_a_platform_without_stored_code_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, platform: Platform, told: str
) -> None:
    monkeypatch.setattr(machine_code, "this_platform", lambda: platform)
    monkeypatch.setattr(machine_code, "stored_folder", lambda package, platform: tmp_path)
    monkeypatch.setattr(machine_code, "_has_compiler", lambda: False)
    machine_code.manifest.cache_clear()
    try:
        with pytest.raises(MbdkitError, match=told):
            machine_code.address_of("motions__motions_at")
    finally:
        machine_code.manifest.cache_clear()


def test_changed_sources_without_a_compiler_are_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine_code, "_has_compiler", lambda: False)
    monkeypatch.setattr(machine_code, "digest", lambda file: "another")
    with pytest.raises(MbdkitError, match=r"differ from their stored machine code"):
        machine_code.address_of("motions__motions_at")


def test_a_level_that_this_platform_does_not_have_is_refused() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mbdkit", "run", "pendulum"], env=os.environ | {"MBDKIT_PROCESSOR": "armv8"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    wanted = "MBDKIT_PROCESSOR should be one of x86-64-v4, x86-64-v3, x86-64-v2"
    assert done.stderr == f"error: the environment variable {wanted}, not 'armv8'\n"


@pytest.mark.parametrize("wrong", [np.zeros(3, dtype=np.float32), np.zeros((3, 1)), np.zeros(6)[::2]])
def test_a_kernel_refuses_arrays_of_another_layout(wrong: np.ndarray) -> None:
    numbers = np.zeros(1, dtype=np.int64)
    with pytest.raises(TypeError, match="a kernel needs a C-contiguous array of float64 with 1 dimensions"):
        motions_at(wrong, numbers, numbers, np.zeros(1), np.zeros((1, 3)), np.zeros((3, 1, 3)))


def test_the_address_of_an_array_follows_from_its_header() -> None:
    x = np.arange(12.0).reshape(3, 4)[1]
    assert array_words(x) == (0, 0, 4, 8, x.ctypes.data, 4, 8)
