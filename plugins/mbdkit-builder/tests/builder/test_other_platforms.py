"""Machine code for other platforms, run here: for linux-aarch64 by QEMU, for windows-x86_64 by Wine.

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
from pathlib import Path

import pytest

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, Platform, is_able, this_platform

from .emulated_python import emulated_python

HERE = Path(__file__).parent
AARCH64, WINDOWS = Platform("linux", "aarch64"), Platform("windows", "x86_64")
SYSROOT = "/usr/aarch64-linux-gnu"
EMULATORS = {AARCH64: ["qemu-aarch64", "-L", SYSROOT], WINDOWS: ["wine"]}
NEEDED = {AARCH64: "qemu-user and libc6-arm64-cross", WINDOWS: "wine and wine64"}
TRIPLES = {AARCH64: "aarch64-linux-gnu.2.17", WINDOWS: "x86_64-windows-gnu"}
LEVEL = next(level for level in PLATFORMS[Platform("linux", "x86_64")] if level.lanes == 2)
"""Calls are recorded with as many lanes as linux-aarch64 has."""


def skip_without(target: Platform) -> None:
    """Skip a test if this machine cannot run programs of a platform."""
    command = EMULATORS[target]
    if shutil.which(command[0]) is None or (target == AARCH64 and not Path(SYSROOT).is_dir()):
        pytest.skip(f"this needs {NEEDED[target]}")
    if not machine_code.stored_folder(machine_code.CORE, target).is_dir():
        pytest.skip(f"no machine code is stored for {target}")


@pytest.fixture(scope="module", params=EMULATORS, ids=str)
def target(request: pytest.FixtureRequest) -> Platform:
    """A platform whose programs run here, and for which Zig compiles the driver."""
    pytest.importorskip("ziglang")
    skip_without(request.param)
    found: Platform = request.param
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
    target: Platform, recording: tuple[Path, set[str]], tmp_path: Path
) -> None:
    path, reached = recording
    driver = tmp_path / "call_driver.exe"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", TRIPLES[target], "-O2", "-o", str(driver)]
    subprocess.run([*command, str(HERE / "call_driver.c")], check=True)
    level = next(level.name for level in target.levels if level.lanes == LEVEL.lanes)
    libraries: list[str] = []
    groups: dict[str, tuple[str, str]] = {}
    for package in machine_code.kernel_packages():
        folder = machine_code.stored_folder(package, target)
        for packed in folder.glob(f"*-{level}.*.xz"):
            library = tmp_path / f"{package}-{packed.stem}"
            library.write_bytes(lzma.decompress(packed.read_bytes()))
            libraries.append(f"./{library.name}")
        symbols = json.loads((folder / machine_code.MANIFEST).read_bytes())["symbols"]
        groups |= {symbol: (package, group) for symbol, (group, _) in symbols.items()}
    assert {groups[symbol] for symbol in reached} == set(groups.values())
    environment = os.environ | {"WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"}
    done = subprocess.run(
        [*EMULATORS[target], f"./{driver.name}", os.path.relpath(path, tmp_path), *libraries],
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
    skip_without(AARCH64)
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(tmp_path), str(HERE.parents[3])]
    subprocess.run(command, env=os.environ | {"MBDKIT_WHEEL": str(AARCH64)}, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    emulated = emulated_python(tmp_path, wheel)
    given = ["-c", PROGRAM, json.dumps(EXAMPLES)]
    expected = subprocess.run([sys.executable, *given], check=True, capture_output=True, text=True).stdout
    assert len(expected.splitlines()) == len(EXAMPLES)
    done = subprocess.run([*emulated, *given], check=True, capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == expected
