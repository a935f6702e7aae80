"""The compile paths: fast within the tested versions of Numba, plain outside; both compute the same."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mbdkit.engine.jit.numba_version import INSTALLED, TESTED_NUMBA, is_tested, numba_report

PROGRAM = """\
import mbdkit
from mbdkit.runs import preparation as run_preparation
from mbdkit.engine.jit.numba_version import PLAIN
run_preparation.ensure_compiled = lambda notify: None  # compile the kernels of these two runs instead of all
print(PLAIN)
for integrator in {"name": "rk4"}, {"name": "gauss"}:
    with mbdkit.run("double-pendulum", integrator=integrator, time={"end": 0.2, "step": 0.01}) as run:
        print(run.data_sha256)
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
@pytest.mark.skipif(not is_tested(INSTALLED), reason="this version of Numba has the plain path only")
def test_the_plain_path_computes_the_same_bits() -> None:
    # expected: reference counts and separate linking change no arithmetic
    found = {}
    for plain in ("0", "1"):
        environment = os.environ | {"MBDKIT_PLAIN_NUMBA": plain}
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
        )
        path, *hashes = done.stdout.split()
        found[path] = hashes
    assert set(found) == {"False", "True"}
    assert found["False"] == found["True"]
    assert all(len(one) == 64 for one in found["True"])
