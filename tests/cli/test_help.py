"""The face of the command line."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

import mbdkit as package
from mbdkit.base import progress_bars
from mbdkit.base.errors import PluginError, RunError, SpecError

TOP = ["run", "validate", "equilibrium", "modes", "kinematics", "plot", "animate", "report", "rerun", "study", "guide"]
GROUPS = {"schema": "run study", "plugins": "list show verify doctor new", "examples": "copy", "archive": "info check"}
COMMANDS = [(), *((name,) for name in [*TOP, *GROUPS])]
COMMANDS += [(group, name) for group, names in GROUPS.items() for name in names.split()]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_help_that_fits_a_terminal(command, mbdkit):
    result = mbdkit(*command, "--help")
    assert result.exit_code == 0
    assert all(len(line) <= 80 for line in result.stdout.splitlines())
    assert "..." not in result.stdout.replace("{FILE.h5}...", "").replace("[ARGS]...", "").replace("[TOPIC]...", "")


@pytest.mark.parametrize(("command", "lists"), [("run", ("examples",)), ("study", ("study", "--help"))])
def test_what_the_help_names_as_packaged_is_packaged(command, lists, mbdkit):
    named = " ".join(mbdkit(command, "--help").stdout.split()).split("such as ")[1].split(".")[0]
    assert named in mbdkit(*lists).stdout.replace(f"such as {named}", "")


PAGE = (Path(__file__).parent / "refusals.md").read_text(encoding="utf-8")
REFUSALS = re.findall(r"^    mbdkit (.+)\n    (.+)$", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("command", "message"), REFUSALS)
def test_commands_refuse_wrong_input_in_the_words_of_the_page(command, message, mbdkit, in_tmp_path):
    result = mbdkit(*shlex.split(command))
    assert result.exit_code == 2
    assert result.stdout == ""
    pattern = re.escape(message).replace(re.escape("..."), ".+")
    assert re.fullmatch(pattern, result.stderr.strip().splitlines()[-1])


@pytest.mark.parametrize("arguments", [("run",), ("run", "--stpe"), ("plot", "x.h5", "--kind", "pie")])
def test_wrong_usage_is_exit_status_2_and_says_so(arguments, mbdkit):
    result = mbdkit(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert re.search("[Ee]rror: ", result.stderr)


def test_version(mbdkit):
    assert mbdkit("--version").stdout == f"mbdkit {package.__version__}\n"


def test_plugins_list_show_and_doctor(mbdkit):
    listed = json.loads(mbdkit("plugins", "list", "--json").stdout)["plugins"]
    assert {"id", "kind", "distribution", "version", "status", "error", "evidence"} == set(listed[0])
    assert "mbdkit:gauss" in mbdkit("plugins", "list").stdout
    assert "stages" in mbdkit("plugins", "show", "gauss").stdout
    assert json.loads(mbdkit("plugins", "show", "gauss", "--json").stdout)["plugins"][0]["claims"]["symplectic"]
    assert mbdkit("plugins", "show", "gaus").exit_code == 2
    assert "loaded" in mbdkit("plugins", "doctor").stdout
    assert json.loads(mbdkit("plugins", "doctor", "--json").stdout)["plugins"]


@pytest.mark.parametrize(
    ("error", "status", "words"),
    [
        (SpecError("is wrong", key="a.b"), 2, "error: a.b: is wrong"),
        (PermissionError(13, "Permission denied", "x.h5"), 3, "error: x.h5: Permission denied"),
        (MemoryError(), 3, "error: there is not enough memory"),
        (RunError("stopped"), 3, "error: stopped"),
        (PluginError("acme failed"), 4, "error: acme failed"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (ZeroDivisionError("by zero"), 1, "error: this is a bug in mbdkit: ZeroDivisionError: by zero"),
    ],
)
def test_every_error_is_a_sentence_and_an_exit_status(error, status, words, mbdkit, monkeypatch):
    def fail(*arguments):
        raise error

    monkeypatch.setattr("mbdkit.spec.load_spec", fail)
    result = mbdkit("validate", "pendulum")
    assert result.exit_code == status
    assert result.stderr.startswith(words)
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


def test_without_a_terminal_there_is_no_progress_bar():
    with progress_bars.progress_bar("run") as advance:
        assert advance is None


def test_on_a_terminal_a_bar_appears_once_work_takes_long(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr(progress_bars, "PATIENCE", 0.0)
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bars.progress_bar("run") as advance:
        advance(0.0, 2.0)
        advance(1.0, 2.0)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "t = 1 of 2 s" in captured.err


def test_quiet_has_no_bar_on_a_terminal_either(monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress_bars.progress_bar("run", quiet=True) as advance:
        assert advance is None


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        ("re", "report rerun"),
        ("run pend", "pendulum"),
        ("examples copy first", "first-run"),
        ("guide mecha", "mechanics mechanism"),
        ("plot run.h5 --kind rea", "reactions"),
        ("plot run.h5 --joint J", "J1"),
        ("plot missing.h5 --joint J", ""),
    ],
)
def test_the_shell_completes_commands_examples_topics_and_names(
    words, completed, mbdkit_process, monkeypatch, in_tmp_path
):
    if "run.h5" in words:
        package.run("pendulum", archive="run.h5")
    monkeypatch.setenv("_MBDKIT_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"mbdkit {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    assert mbdkit_process().stdout.split() == completed.split()
