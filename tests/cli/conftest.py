"""Running the command line, in this process and in one of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from typer.testing import CliRunner

from mbdkit.cli import app
from tests.spec_texts import SMALL

COMPILING = re.compile(r"mbdkit compiles |\.\.\. compiled in ")
"""Notes on compilation."""


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
def refusal(mbdkit: Callable[..., Any]) -> Callable[..., str]:
    """Run a command that must end with status 2 and one message, and leave no file behind; return the message."""

    def invoke(*arguments: str, stdin: str | None = None) -> str:
        before = sorted(os.listdir())
        result = mbdkit(*arguments, stdin=stdin)
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert "Traceback" not in result.stderr
        assert sorted(os.listdir()) == before
        told = result.stderr.splitlines()
        # with an empty cache, the notes on compilation come before
        first, *more = told[next((i for i, line in enumerate(told) if not COMPILING.match(line)), 0) :]
        assert first.startswith("error: ")
        assert all(line.startswith("  ") for line in more)
        return str(first.removeprefix("error: "))

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
