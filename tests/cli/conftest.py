"""Running the command line, in this process and in one of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from typer.testing import CliRunner

from mbdkit.cli import app

SMALL = """\
mbdkit: 1
model:
  name: double-pendulum
  masses: [1.0, 1.0]
integrator: {name: gauss, stages: 2}
time:
  end: 1.0
  step: 0.01
"""


@pytest.fixture
def small() -> str:
    """A spec of few words, for a test to change."""
    return SMALL


@pytest.fixture
def mbdkit() -> Callable[..., Any]:
    """Run a command in this process; the result has exit_code, stdout and stderr."""

    def invoke(*arguments: str, stdin: str | bytes | None = None) -> Any:
        return CliRunner().invoke(app, list(arguments), input=stdin, prog_name="mbdkit")

    return invoke


@pytest.fixture
def mbdkit_process() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run a command in a process of its own."""

    def invoke(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
        command: Sequence[str] = [sys.executable, "-m", "mbdkit", *arguments]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env=os.environ | {"COLUMNS": "80"}, **options
        )

    return invoke
