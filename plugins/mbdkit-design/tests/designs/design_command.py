"""The command of designs, run in this process."""

from __future__ import annotations

from typer.testing import CliRunner, Result

from mbdkit.cli import app


def command(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments), prog_name="mbdkit")
