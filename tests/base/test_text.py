"""Text from outside is shown, and obeyed nowhere."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mbdkit.base.errors import ResourceError, RunError, SpecError
from mbdkit.base.terminal import PlainStream, command_line, executing
from mbdkit.base.text import csv_cell, shown, table
from mbdkit.spec import load_spec


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a\x1b[2Jb", "a\\u001b[2Jb"),
        ("\x9b31m", "\\u009b31m"),
        ("first\r\nverdict good", "first\\r\\nverdict good"),
        ("abc\u202edef", "abc\\u202edef"),
        ("Kniegelenk, größer · 膝関節 · 👩‍🔬", "Kniegelenk, größer · 膝関節 · 👩‍🔬"),
    ],
)
def test_control_characters_are_escaped(text: str, words: str) -> None:
    assert shown(text) == words
    assert table([("TITLE",), (text,)]).splitlines() == ["TITLE", words]


FORGED = "x\nall is well"


@pytest.mark.parametrize("error", [SpecError("wrong", key=FORGED, file=FORGED), ResourceError("full", file=FORGED)])
def test_names_in_errors_do_not_add_lines(error: Exception) -> None:
    assert str(error).startswith("x\\nall is well: ")
    assert "\n" not in str(error)


@pytest.mark.parametrize("sections", [{FORGED: 1}, {"title": {FORGED: 1}}, {"formulation": FORGED}, {"model": FORGED}])
def test_keys_and_values_of_a_spec_do_not_add_lines(sections: dict[str, Any]) -> None:
    with pytest.raises(SpecError) as caught:
        load_spec("pendulum", **sections)
    assert "all is well" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_stream_for_the_terminal_keeps_lines_and_valid_json() -> None:
    stream = io.StringIO()
    print("a\x1bb\n\tc", file=PlainStream(stream))
    assert stream.getvalue() == "a\\u001bb\n\tc\n"
    stream = io.StringIO()
    print(json.dumps({"title": "\x9b\u202e"}, ensure_ascii=False), file=PlainStream(stream))
    assert json.loads(stream.getvalue()) == {"title": "\x9b\u202e"}


@pytest.mark.parametrize("start", "=+-@\uff1d\uff20")
def test_a_spreadsheet_takes_no_text_for_a_formula(start: str) -> None:
    assert csv_cell(f"{start}cmd|' /C calc'!A0.x") == f"'{start}cmd|' /C calc'!A0.x"
    assert csv_cell("rod1.x") == "rod1.x"


def test_a_usage_error_is_text(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mbdkit", "archive", "info", "--bogus"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("Error: ")
    assert "--bogus" in done.stderr
    command = [sys.executable, "-m", "mbdkit", "archive", "check", "\x1b[31m.h5"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr == "\\u001b[31m.h5: there is no such file\n"


@pytest.mark.skipif(sys.platform == "win32", reason="names of files are not bytes")
def test_the_command_in_an_archive_is_valid_text_even_if_a_name_is_not() -> None:
    with executing(["mbdkit", "run", "-o", "\udcc3\udcb6.h5"]):  # the UTF-8 bytes of "ö", as decoded in the locale C
        assert command_line() == "mbdkit run -o 'ö.h5'"
    with executing(["mbdkit", "run", "-o", "\udcff.h5"]):
        assert command_line() == "mbdkit run -o '\\xff.h5'"


def test_sentences_do_not_repeat_long_input() -> None:
    for word in ("x" * 100_000, "x " * 50_000, "x\n" * 3 + "y" * 100_000):
        for error in (SpecError(f"no '{word}'; use a", key=word, file=word), RunError(word), ResourceError(word)):
            assert len(str(error)) < 12_000
    assert str(SpecError(f"there is no '{'x' * 100_000}' here; use a")).endswith("xxx... here; use a")
