"""Checks that the stored machine code is what the sources say.

The digests of all sources and of the builder are compared with those in the manifests. The code of one of the small
libraries for x86-64-v3 is built again and compared byte by byte; which one depends on the commit. The large ones, which
take minutes each, are built again once a week (``python -m mbdkit_builder check``).
"""

import filecmp
import subprocess
import sys
import tempfile
from pathlib import Path

from mbdkit.engine.native import machine_code
from mbdkit.engine.native.levels import PLATFORMS, chosen_level
from mbdkit_builder.libraries import build, group_of
from mbdkit_builder.lowering import symbols
from mbdkit_builder.sources import builder_digests

LEVEL = "x86-64-v3"
SMALL = 3  #: Largest number of kernels of a small library.


def main() -> int:
    """Return 0 if the machine code is up to date."""
    stale, libraries = [], []
    for package in machine_code.kernel_packages():
        if machine_code.manifest(package).get("builder") != builder_digests():
            stale.append(f"all of {package}, which was built with another builder")
        known = symbols(package)
        groups = sorted({group_of(symbol) for symbol in known})
        libraries += [(package, [symbol for symbol in known if group_of(symbol) == group]) for group in groups]
        stale += [symbol for symbol in known if machine_code.stored_file(symbol, chosen_level()) is None]
    if stale:
        print(f"out of date: {', '.join(stale[:10])}{', ...' * (len(stale) > 10)}; run `mbdkit_builder build --all`")
        return 1
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout
    small = [library for library in libraries if len(library[1]) <= SMALL]
    package, names = small[int(commit, 16) % len(small)]
    (target,) = (one for one in PLATFORMS if str(one) == "linux-x86_64")
    with tempfile.TemporaryDirectory() as work:
        again = Path(work) / "again"
        build({target: again}, names, only=LEVEL)
        (name,) = (path.name for path in again.glob(f"*-{LEVEL}.so.xz"))
        if not filecmp.cmp(again / name, machine_code.stored_folder(package, target) / name, shallow=False):
            print(f"{name} of {package} is not what the sources say")
            return 1
    print(f"all digests agree, and {name} of {package} is what the sources say, to the byte")
    return 0


if __name__ == "__main__":
    sys.exit(main())
