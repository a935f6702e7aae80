"""Machine code for other platforms, run here: for linux-aarch64 by QEMU, for windows-x86_64 by Wine, and that of
linux-x86_64 with another C library, musl.

Calls of kernels are recorded while examples are simulated here (`call_recorder`); a small C program (`call_driver.c`)
repeats them with the libraries of the other platform. The slow test runs mbdkit itself.
"""

from __future__ import annotations

import json
import lzma
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform, is_able, this_platform

from .emulated_python import emulated_python

HERE = Path(__file__).parent
AARCH64, WINDOWS, X86_64 = Platform("linux", "aarch64"), Platform("windows", "x86_64"), Platform("linux", "x86_64")
SYSROOT = Path("/usr/aarch64-linux-gnu")


@dataclass(frozen=True)
class Target:
    """Where machine code is run: its platform, the target of the C compiler, the command that runs a program, the file
    that must exist, and the Debian packages with both.
    """

    platform: Platform
    triple: str
    command: tuple[str, ...]
    file: Path
    packages: str


ARM = Target(AARCH64, "aarch64-linux-gnu.2.17", ("qemu-aarch64", "-L", str(SYSROOT)), SYSROOT,
             "qemu-user and libc6-arm64-cross")  # fmt: skip
TARGETS = {
    "linux-aarch64": ARM,
    "windows-x86_64": Target(WINDOWS, "x86_64-windows-gnu", ("wine",), Path("/"), "wine and wine64"),
    "musl": Target(X86_64, "x86_64-linux-musl", ("/lib/ld-musl-x86_64.so.1",), Path("/"), "musl"),
}
LEVEL = next(level for level in PLATFORMS[X86_64] if level.lanes == 2)
"""Calls are recorded with as many lanes as linux-aarch64 has."""


def skip_without(target: Target) -> None:
    """Skip a test if this machine cannot run programs of a target."""
    if shutil.which(target.command[0]) is None or not target.file.exists():
        pytest.skip(f"this needs {target.packages}")
    if not machine_code.stored_folder(machine_code.CORE, target.platform).is_dir():
        pytest.skip(f"no machine code is stored for {target.platform}")


@pytest.fixture(scope="module", params=TARGETS)
def target(request: pytest.FixtureRequest) -> Target:
    """A target whose programs run here, and for which Zig compiles the driver."""
    pytest.importorskip("ziglang")
    found = TARGETS[request.param]
    skip_without(found)
    return found


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, set[str]]:
    """A file of recorded calls, and the symbols of the machine code that they reach."""
    if LEVEL not in this_platform().levels or not is_able(LEVEL):
        pytest.skip(f"calls are recorded on processors of level {LEVEL.name}")
    path = tmp_path_factory.mktemp("calls") / "calls"
    command = [sys.executable, str(HERE / "call_recorder.py"), str(path)]
    environment = os.environ | {"MBDKIT_PROCESSOR": LEVEL.name}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return path, set(done.stdout.split())


def test_kernels_have_the_bits_of_this_platform(
    target: Target, recording: tuple[Path, set[str]], tmp_path: Path
) -> None:
    path, reached = recording
    driver = tmp_path / "call_driver.exe"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target.triple, "-dynamic", "-O2"]
    subprocess.run([*command, "-o", str(driver), str(HERE / "call_driver.c")], check=True)
    level = next(level.name for level in target.platform.levels if level.lanes == LEVEL.lanes)
    libraries: list[str] = []
    groups: dict[str, tuple[str, str]] = {}
    for package in machine_code.kernel_packages():
        folder = machine_code.stored_folder(package, target.platform)
        for packed in folder.glob(f"*-{level}.*.xz"):
            library = tmp_path / f"{package}-{packed.stem}"
            library.write_bytes(lzma.decompress(packed.read_bytes()))
            libraries.append(f"./{library.name}")
        symbols = json.loads((folder / machine_code.MANIFEST).read_bytes())["symbols"]
        groups |= {symbol: (package, group) for symbol, (group, _) in symbols.items()}
    assert {groups[symbol] for symbol in reached} == set(groups.values())
    environment = os.environ | {"WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"}
    done = subprocess.run(
        [*target.command, f"./{driver.name}", os.path.relpath(path, tmp_path), *libraries],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    equal, _, count = done.stdout.split()[:3]
    assert equal == count
    assert int(count) >= 200


EXAMPLES = {
    "crank-press": 0.1, "flying-spaghetti": 0.05, "four-bar": 0.1, "knee": 0.1, "chain": 0.05,
    "leaf-spring": 0.05, "pendulum": 0.2, "slider-crank": 0.1, "spin-up-beam": 0.1, "squat": 0.05,
}  # fmt: skip
"""Examples, three of them with beams, and where they end [s]."""
PROGRAM = """\
import json, sys, mbdkit
from mbdkit.spec import load_spec
for name, end in json.loads(sys.argv[1]).items():
    print(name, mbdkit.run(load_spec(name, [f"time.end={end}"])).data_sha256)
"""


@pytest.mark.slow
def test_examples_on_aarch64_have_the_hashes_of_this_platform(tmp_path: Path) -> None:
    skip_without(ARM)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(HERE.parents[3])]
    subprocess.run(command, env=os.environ | {"MBDKIT_WHEEL": str(AARCH64)}, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    emulated = emulated_python(tmp_path, wheel)
    given = ["-c", PROGRAM, json.dumps(EXAMPLES)]
    expected = subprocess.run([sys.executable, *given], check=True, capture_output=True, text=True).stdout
    assert len(expected.splitlines()) == len(EXAMPLES)
    done = subprocess.run([*emulated, *given], check=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == expected
