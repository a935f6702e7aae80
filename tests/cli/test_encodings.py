"""Commands whose output is encoded as on Windows, where pipes and terminals have code pages instead of UTF-8."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mbdkit.base import terminal

SPEC = """\
mbdkit: 1
title: "Kni\u00e9 \u00b5\u00b2 \u2192 \u819d \U0001f9b5"
model: {name: single-pendulum}
integrator: {name: rk4}
time: {end: 0.02, step: 0.01}
"""


def output(folder: Path, encoding: str, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    command = [sys.executable, "-m", "mbdkit", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False, timeout=120)


def test_characters_that_an_encoding_lacks_are_escaped(tmp_path: Path) -> None:
    (tmp_path / "\u00b5\u819d.yaml").write_text(SPEC, encoding="utf-8")
    done = output(tmp_path, "cp1252:strict", "run", "\u00b5\u819d.yaml")
    assert done.returncode == 0, done.stderr
    assert "Kni\u00e9 \u00b5\u00b2 \\u2192 \\u819d \\U0001f9b5" in done.stdout.decode("cp1252")
    described = output(tmp_path, "ascii:strict", "archive", "info", "--json", "\u00b5\u819d.h5")
    (archive,) = json.loads(described.stdout.decode("ascii"))["archives"]
    assert archive["title"] == "Kni\u00e9 \u00b5\u00b2 \u2192 \u819d \U0001f9b5"
    refused = output(tmp_path, "cp850:strict", "run", "\u819d.yaml")
    assert refused.returncode == terminal.WRONG_INPUT
    assert b"error: \\u819d.yaml: there is no such file" in refused.stderr


def test_a_closed_pipe_is_recognized_by_the_error_of_windows() -> None:
    """Python's `subprocess` documents the same error: EINVAL, where other systems report EPIPE."""

    class Closed(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.EINVAL, "Invalid argument")

    with pytest.raises(BrokenPipeError):
        terminal._Results(Closed()).show("result")
