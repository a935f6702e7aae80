"""Runs by which machine code is compared, and the hashes of their data."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

from mbdkit.engine.native.levels import this_platform

IS_STORED = str(this_platform()) == "linux-x86_64"


stored = pytest.mark.skipif(not IS_STORED, reason="no machine code is stored for this platform")


RUNS = """\
import json, sys
if {without_numba}:
    sys.modules["numba"] = sys.modules["llvmlite"] = None
import mbdkit
found = {{}}
for name, sections in json.loads({runs!r}).items():
    with mbdkit.run(name.split()[0], **sections) as run:
        found[name] = run.data_sha256
print(json.dumps(found))
"""


SHORT: dict[str, Any] = {"time": {"end": 0.03, "step": 0.01}}


SPECS: dict[str, Any] = {
    "double-pendulum rk4": SHORT | {"integrator": {"name": "rk4"}},
    "double-pendulum gauss": SHORT | {"integrator": {"name": "gauss", "stages": 2}},
    "knee radau-iia": SHORT | {"integrator": {"name": "radau-iia"}, "formulation": "index-3"},
    "knee scipy": SHORT | {"integrator": {"name": "scipy-dop853"}},
}


def hashes(specs: dict[str, Any], *, without_numba: bool = True, **variables: str) -> dict[str, str]:
    """Return the hashes of runs in a process of its own, with these environment variables."""
    program = RUNS.format(without_numba=without_numba, runs=json.dumps(specs))
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found
