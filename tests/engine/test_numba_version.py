"""The compile paths: fast within the tested versions of Numba, plain outside; both compute the same."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mbdkit.engine.jit.numba_version import INSTALLED, TESTED_NUMBA, is_tested, numba_report

PROGRAM = """\
import sys
import mbdkit
from mbdkit.engine.jit.numba_version import PLAIN
spec = {"mbdkit": 1, "model": {"name": "double-pendulum"}, "integrator": {"name": "gauss"},
        "time": {"end": 0.2, "step": 0.01}}
run = mbdkit.run(spec)
print(PLAIN, *(float(x).hex() for name in ("rod1", "rod2") for x in run[name].angle))
"""


def test_the_tested_range_includes_both_ends_and_their_patch_releases() -> None:
    oldest, newest = TESTED_NUMBA
    assert is_tested(f"{oldest}.0")
    assert is_tested(f"{newest}.9")
    assert not is_tested("0.60.0")
    assert not is_tested("1.0.0")


def test_the_report_names_the_installed_version() -> None:
    assert numba_report()["version"] == INSTALLED
    assert numba_report()["tested"] is is_tested(INSTALLED)


@pytest.mark.slow
def test_the_plain_path_computes_the_same_bits() -> None:
    # expected: reference counts and separate linking change no arithmetic
    found = {}
    for plain in ("0", "1"):
        environment = os.environ | {"MBDKIT_PLAIN_NUMBA": plain}
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
        )
        name, *values = done.stdout.split()
        found[name] = values
    assert set(found) == {"False", "True"}
    assert found["False"] == found["True"]
