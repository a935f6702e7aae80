"""Results under settings that choose other machine code, as other processors would, for `bits`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

PLAIN = "as it is"


def settings() -> dict[str, dict[str, str]]:
    """Return the settings by name, each with its environment variables; the first is without any.

    The settings of the C library and of OpenBLAS act on x86-64 only, and those of NumPy disable what it has found.
    """
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])  # missing if all are disabled
    return {
        PLAIN: {},
        **{f"level v{n}": {"MBDKIT_PROCESSOR": f"x86-64-v{n}"} for n in (2, 3, 4)},
        **{f"OpenBLAS {name}": {"OPENBLAS_CORETYPE": name} for name in ("Nehalem", "Haswell", "SkylakeX")},
        "NumPy": {"NPY_DISABLE_CPU_FEATURES": " ".join(found)},
        "C library": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-FMA4"},
    }


def compare_settings(folder: Path, only: str, chosen: list[str]) -> int:
    """Compute the results under each setting, print a table, and return how many differ from those without settings.

    Parameters
    ----------
    folder
        Folder with a subfolder for each setting.
    only
        A part of the names of the combinations to run.
    chosen
        Names of the settings; all if empty.
    """
    every = settings()
    names = [PLAIN, *(name for name in (chosen or every) if name != PLAIN)]
    results: dict[str, dict[str, Any]] = {}
    for name in names:
        part = folder / name.replace(" ", "-")
        command = [sys.executable, "-m", "tests.benchmarks.bits", str(part), "--only", only]
        subprocess.run(command, env=os.environ | every[name], stdout=subprocess.DEVNULL, check=True)
        results[name] = json.loads((part / "hashes.json").read_text())
    others = names[1:]
    width = max(map(len, results[PLAIN]))
    print(" " * width, *others, sep="  ")
    differing = 0
    for result, value in results[PLAIN].items():
        is_equal = [results[name][result] == value for name in others]
        differing += is_equal.count(False)
        words = ("equal" if same else "differs" for same in is_equal)
        print(
            result.ljust(width), *(f"{word:>{len(name)}}" for name, word in zip(others, words, strict=True)), sep="  "
        )
    print(f"{differing} of {len(results[PLAIN]) * len(others)} results differ from those without settings")
    return differing
