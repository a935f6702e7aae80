"""The installed version of Numba, and whether compilation uses internals of Numba.

Within the tested range, functions that only kernels call are compiled by `mbdkit.engine.jit.subkernel_compiler`, and
without reference counts. Both use internals of Numba and make compilation faster. With any other version, plain
``numba.njit`` compiles them: with 0.68.1 this takes twice the CPU time and computes the same bits. Setting
``MBDKIT_PLAIN_NUMBA=1`` selects the plain path with any version. Some internals are used on both paths; see
`mbdkit.engine.jit.bundle`, `mbdkit.engine.jit.law_calls` and `mbdkit.engine.jit.cache`.

This module does not import Numba.
"""

from __future__ import annotations

import os
from importlib.metadata import version
from typing import Any

TESTED_NUMBA = ("0.61", "0.68")
"""Oldest and newest Numba, as major.minor, with which the numerical tests passed: 0.61.0 and 0.68.1.

Of the versions between, one has run one example: 0.64.0.
"""


def is_tested(installed: str) -> bool:
    """Return whether a version of Numba, such as ``"0.61.2"``, is within the tested range."""
    oldest, newest = (_major_minor(text) for text in TESTED_NUMBA)
    return oldest <= _major_minor(installed) <= newest


def _major_minor(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split(".")[:2])


INSTALLED = version("numba")
PLAIN = os.environ.get("MBDKIT_PLAIN_NUMBA", "") not in ("", "0") or not is_tested(INSTALLED)
"""Whether all functions are compiled by plain ``numba.njit``."""


def numba_report() -> dict[str, Any]:
    """Return version, tested range and compile path of the installed Numba."""
    return {
        "version": INSTALLED,
        "tested": is_tested(INSTALLED),
        "tested_range": list(TESTED_NUMBA),
        "compile_path": "plain" if PLAIN else "fast",
    }


def numba_text() -> str:
    """Return the report as one line."""
    oldest, newest = TESTED_NUMBA
    if not is_tested(INSTALLED):
        return f"Numba {INSTALLED}: outside the tested range {oldest} to {newest}; kernels take longer to compile"
    forced = "; kernels take longer to compile, because MBDKIT_PLAIN_NUMBA is set" if PLAIN else ""
    return f"Numba {INSTALLED}: within the tested range {oldest} to {newest}{forced}"
