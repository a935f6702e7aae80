"""A process that has imported mbdkit, and runs each command that it is given in a fork of itself.

The fork is what a new process is after a second of imports: it has loaded no plugins and read no specs.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

IMPORTED = ("mbdkit.cli", "mbdkit.runs.simulation", "mbdkit.archive.run", "mbdkit_studies.compute.carry_out")
"""Modules that import what most commands need."""

PATIENCE = 600
"""Time after which a command is killed [s]."""


def run_mbdkit(
    arguments: Sequence[str], path: Sequence[Path], cwd: Path, environment: Mapping[str, str]
) -> subprocess.CompletedProcess[str]:
    """Run ``mbdkit ARGUMENTS`` with these folders first on the path and with this whole environment."""
    zygote = _zygote(os.getpid())
    assert zygote.stdin is not None
    assert zygote.stdout is not None
    with tempfile.TemporaryDirectory() as folder:
        streams = [str(Path(folder) / name) for name in ("out", "err")]
        order = {"words": arguments, "path": [*map(str, path)], "cwd": str(cwd), "env": dict(environment)}
        zygote.stdin.write(json.dumps(order | {"streams": streams}) + "\n")
        zygote.stdin.flush()
        status = int(zygote.stdout.readline())
        said = [Path(name).read_text(encoding="utf-8") for name in streams]
    return subprocess.CompletedProcess(arguments, status, *said)


@cache
def _zygote(parent: int) -> subprocess.Popen[str]:
    """Start the process, one for each process of tests; it ends when its standard input is closed."""
    command = [sys.executable, "-m", "tests.zygote"]
    root = str(Path(__file__).parents[1])
    folders = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), root]))
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | {"PYTHONPATH": folders}, text=True
    )


def main() -> None:
    """Carry out orders until standard input is closed."""
    for module in IMPORTED:
        importlib.import_module(module)
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        child = os.fork()
        if not child:
            _carry_out(json.loads(line))
        answers.write(f"{os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])}\n")
        answers.flush()


def _carry_out(order: dict[str, Any]) -> None:
    status: Any = 1
    signal.alarm(PATIENCE)
    try:
        for place, name in enumerate((os.devnull, *order["streams"])):
            with open(name, "r+b" if place == 0 else "wb") as stream:
                os.dup2(stream.fileno(), place)
        os.chdir(order["cwd"])
        os.environ.clear()
        os.environ.update(order["env"])
        sys.path[:0] = order["path"]
        importlib.invalidate_caches()
        sys.argv = ["mbdkit", *order["words"]]
        runpy.run_module("mbdkit", run_name="__main__", alter_sys=True)
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(Exception):
                stream.flush()
        os._exit(status)


if __name__ == "__main__":
    main()
