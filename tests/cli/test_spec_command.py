"""Commands that plugins make with `SpecCommand`."""

from __future__ import annotations

import inspect
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from typer.testing import CliRunner, Result

from mbdkit.base.errors import SpecError
from mbdkit.plugin import SpecCommand


def launched(source: str, assignments: Sequence[str]) -> str:
    return " ".join([source, *assignments])


@SpecCommand.of("a packaged launch", "The flight", key="fuel=2")
def launch(command: SpecCommand, *, high: Annotated[bool, typer.Option("--high", help="Fly high.")] = False) -> None:
    """Launch a rocket."""
    spec = command.load(launched)
    command.notify("a stage")
    command.path.write_text(spec)
    command.conclude(f"{spec}, high: {high}", {"path": str(command.path)}, is_good=not high)


def command(*arguments: str) -> Result:
    app = typer.Typer()
    app.command()(launch)
    return CliRunner().invoke(app, list(arguments))


def test_further_options_stand_between_set_and_overwrite() -> None:
    assert list(inspect.signature(launch).parameters) == [
        "spec",
        "output",
        "assignments",
        "high",
        "overwrite",
        "as_json",
        "quiet",
        "debug",
    ]


def test_a_spec_is_loaded_with_its_assignments_and_the_result_told(in_tmp_path: Path) -> None:
    done = command("up.yaml", "--set", "fuel=3", "--high")
    assert (done.exit_code, done.stdout, done.stderr) == (3, "up.yaml fuel=3, high: True\n", "a stage\n")
    assert Path("up.h5").read_text() == "up.yaml fuel=3"


def test_json_and_quiet_print_no_progress(in_tmp_path: Path) -> None:
    as_json, quiet = command("up.yaml", "--json"), command("-", "-o", "down.h5", "--quiet")
    assert (json.loads(as_json.stdout), as_json.stderr) == ({"path": "up.h5"}, "")
    assert (quiet.exit_code, quiet.stdout, quiet.stderr) == (0, "", "")
    assert Path("down.h5").read_text() == "-"


def test_a_result_that_exists_is_replaced_only_with_overwrite(in_tmp_path: Path) -> None:
    Path("up.h5").touch()
    refused = command("up.yaml")
    assert isinstance(refused.exception, SpecError)
    assert Path("up.h5").read_text() == ""
    assert command("up.yaml", "--overwrite").exit_code == 0
