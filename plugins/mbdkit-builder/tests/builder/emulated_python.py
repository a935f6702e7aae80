"""Python for linux-aarch64 under QEMU: Debian's interpreter, and packages from their wheels, in one folder."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

LIBRARIES = ["libc6", "libstdc++6", "libgcc-s1", "libexpat1", "zlib1g", "libffi8", "libbz2-1.0", "liblzma5", "libuuid1"]
"""Debian's packages on which the interpreter and the wheels depend."""
_TAGS = [f"manylinux_2_{version}_aarch64" for version in (17, 24, 27, 28)] + ["manylinux2014_aarch64"]


def emulated_python(folder: Path, wheel: Path) -> list[str]:
    """Install Python for linux-aarch64, a wheel and what it requires into a folder; return the command for Python.

    Debian's packages are unpacked there, not installed: the machine is left as it is.

    Raises
    ------
    subprocess.CalledProcessError
        If a package cannot be downloaded.
    """
    depends = _output("apt-cache", "depends", "python3-minimal")
    found = re.search(r"Depends: (python(3\.\d+))-minimal", depends)
    assert found, depends
    python, version = found.groups()
    names = [*LIBRARIES, f"{python}-minimal", f"lib{python}-minimal", f"lib{python}-stdlib"]
    lists = folder / "lists/partial"
    lists.mkdir(parents=True)
    options = [f"-oDir::State::lists={lists.parent}", "-oAPT::Architectures=amd64,arm64", "-oAPT::Sandbox::User=root"]
    subprocess.run(["apt-get", "-qq", *options, "update"], check=True)
    subprocess.run(
        ["apt-get", "-qq", *options, "download", *(f"{name}:arm64" for name in names)], check=True, cwd=folder
    )
    root, site = folder / "root", folder / "site"
    for package in folder.glob("*.deb"):
        subprocess.run(["dpkg", "-x", package, root], check=True)
    platforms = [word for tag in _TAGS for word in ("--platform", tag)]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--target", site, "--only-binary=:all:", *platforms,
         "--python-version", version, str(wheel)],
        check=True,
    )  # fmt: skip
    return ["qemu-aarch64", "-L", str(root), "-E", f"PYTHONPATH={site}", str(root / f"usr/bin/{python}")]


def _output(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
