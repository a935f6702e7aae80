"""stdout belongs to results: plugins cannot spoil them, errors are JSON too, and closed streams do no harm."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mbdkit.base.plain_data import json_text
from tests.installing import install_module, python

NOISY = """\
import os
import time
import mbdkit
from pydantic import BaseModel

class Options(BaseModel):
    pass

class Method(mbdkit.StepMethod):
    def step(self, equations, t, state, h):
        print("noise")
        os.write(1, b"noise")
        return state.moved(h * state.v, 0 * state.v)

def create(options):
    print("noise")
    return Method()

@mbdkit.hookimpl
def mbdkit_integrators():
    return [mbdkit.IntegratorPlugin("noisy", "Prints", Options, create, lambda options: mbdkit.Claims(order=1))]
"""

RUN = ("-m", "mbdkit", "run", "pendulum", "--set", "time.end=0.02", "-o", "out.h5")


def test_what_a_plugin_prints_goes_to_stderr(tmp_path: Path) -> None:
    install_module(tmp_path / "site", "acme-noisy", NOISY)
    done = python(*RUN, "--set", "integrator={name: noisy}", "--json", path=(tmp_path / "site",), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["status"] == "complete"
    assert done.stderr.count("noise") >= 5


@pytest.mark.parametrize(
    ("arguments", "status", "key"),
    [
        (("run", "pendulum", "--set", "time.step=x"), 2, "time.step"),
        (("run", "no-such-example"), 2, None),
        (("run",), 2, None),
        (("no-such-command",), 2, None),
        (("archive", "info", "missing.h5"), 2, None),
    ],
)
def test_an_error_is_an_object_with_json(mbdkit, in_tmp_path, arguments, status, key):
    done = mbdkit(*arguments, "--json")
    told = json.loads(done.stdout)
    assert done.exit_code == told["exit_status"] == status
    assert told["error"].strip() in done.stderr
    assert told.get("key") == key
    assert mbdkit(*arguments).stdout == ""


def test_numbers_that_are_not_finite_become_null():
    data = {"a": float("nan"), "b": [float("-inf"), 1.5], "c": (None, True, "nan")}
    assert json.loads(json_text(data)) == {"a": None, "b": [None, 1.5], "c": [None, True, "nan"]}


@pytest.mark.end_to_end
@pytest.mark.parametrize("closed", ["1", "0 1 2"])
def test_a_run_succeeds_with_closed_streams(tmp_path: Path, closed: str) -> None:
    shut = "; ".join(f"exec {number}>&-" for number in closed.split())
    command = " ".join(f"'{word}'" for word in (sys.executable, *RUN, "--json"))
    done = subprocess.run(
        ["bash", "-c", f"{shut}; {command}"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.h5").exists()
    assert (done.stdout == "") == ("1" in closed)
    again = subprocess.run(
        ["bash", "-c", f"{shut}; {command}"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert again.returncode == 2  # the file exists
    assert "1" in closed or json.loads(again.stdout)["exit_status"] == 2


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_a_full_disk_under_stdout_is_an_error_in_one_line(tmp_path: Path) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, *RUN, "--json"], cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 3
    assert done.stderr == "error: No space left on device\n"


@pytest.mark.parametrize("arguments", [("--version",), ("plugins", "new", "--help"), ("run", "-h")])
def test_commands_that_need_no_plugin_import_none(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    install_module(tmp_path / "site", "acme-slow", "raise SystemExit('imported')\n")
    done = python("-m", "mbdkit", *arguments, path=(tmp_path / "site",), cwd=tmp_path)
    assert done.returncode == 0
    assert "acme-slow" not in done.stderr
    assert done.stdout
