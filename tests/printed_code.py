"""The fenced blocks of a page of Markdown, and how a test runs them as a reader would.

Blocks of a page run in order in one empty folder, and its Python blocks share their names. A block that follows "Save
this as `NAME`" is written to that file. Lines of a shell block are commands of mbdkit, which run in this process. The
comment `<!-- not run: REASON -->` above a block leaves it out.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from typer.testing import CliRunner

from mbdkit.cli import app
from mbdkit.trust import criteria
from mbdkit.trust.criteria import Judgement


class Block(NamedTuple):
    """A fenced block: its language, its text, and the text above it up to the block before."""

    language: str
    code: str
    above: str

    @property
    def saved_as(self) -> str:
        """Name of the file that the reader is told to save it as; empty if there is none."""
        told = re.search(r"[Ss]ave (?:this|it|this spec) as `([\w.-]+)`[^`]*\Z", self.above)
        return told[1] if told else ""

    @property
    def is_run(self) -> bool:
        """Whether a test runs it."""
        return not re.search(r"<!-- not run: [^>]+ -->\s*\Z", self.above)


def fenced_blocks(text: str) -> list[Block]:
    """Return the fenced blocks of a page."""
    parts = re.split(r"^```(\w*)\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    return [Block(parts[k + 1], parts[k + 2], parts[k]) for k in range(0, len(parts) - 1, 3)]


def run_blocks(blocks: list[Block], folder: Path) -> list[Judgement]:
    """Run blocks in order in the folder, which is the current one, and return the verdicts on their runs."""
    names: dict[str, Any] = {"__name__": "guide"}
    judged: list[Judgement] = []

    def make_and_keep(*arguments: Any) -> Judgement:
        judged.append(Judgement(*arguments))
        return judged[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(criteria, "Judgement", make_and_keep)
        _run_in_order(blocks, folder, names)
    return judged


def _run_in_order(blocks: list[Block], folder: Path, names: dict[str, Any]) -> None:
    for number, block in enumerate(blocks):
        if not block.is_run:
            continue
        if block.saved_as:
            (folder / block.saved_as).write_text(block.code, encoding="utf-8")
        if block.language == "python":
            exec(compile(block.code, f"block {number}", "exec", dont_inherit=True), names)  # a script of its own
        elif block.language == "sh":
            run_commands(block.code)
        else:
            assert block.saved_as or block.language in ("text", "toml", "bibtex", "yaml"), f"block {number} is not run"


def run_commands(commands: str) -> list[str]:
    """Run each line, a command of mbdkit, and return what they print."""
    printed = []
    for line in commands.splitlines():
        words = shlex.split(line, comments=True)
        if not words:
            continue
        assert words[0] == "mbdkit", f"this is no command of mbdkit: {line}"
        done = CliRunner().invoke(app, words[1:], prog_name="mbdkit")
        assert done.exit_code == 0, f"{line}: {done.stdout}{done.stderr}"
        printed.append(done.stdout)
    return printed
