"""Wheels for one platform: the machine code of this platform alone, loaded in place, and the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform

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
