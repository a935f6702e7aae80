"""Commands that show an archive warn if another program has changed it."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import pytest

from mbdkit import run

COMMANDS = {
    "animate": ("animate", "run.h5", "-o", "out.html"),
    "archive export": ("archive", "export", "run.h5", "--to", "csv"),
    "archive info": ("archive", "info", "run.h5"),
    "plot": ("plot", "run.h5", "--kind", "reactions", "-o", "out.png"),
    "report": ("report", "run.h5", "-o", "out.html"),
}
WARNING = "the data differ from the hash that the program stored"


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_that_show_an_archive_warn_if_its_data_were_scaled(mbdkit, in_tmp_path, command):
    run("pendulum", time={"end": 0.1, "step": 0.01}, archive="run.h5").close()
    unchanged = mbdkit(*COMMANDS[command])
    assert unchanged.exit_code == 0
    assert WARNING not in unchanged.output
    with h5py.File("run.h5", "a") as file:
        file["joints/reaction_force"][...] *= 1e-3
    overwrite = () if command == "archive info" else ("--overwrite",)
    changed = mbdkit(*COMMANDS[command], *overwrite)
    assert changed.exit_code == 0
    assert WARNING in changed.output
    if command == "report":
        (alarm,) = re.findall('<p class="alarm" role="status">(.*?)</p>', Path("out.html").read_text(encoding="utf-8"))
        assert WARNING.removeprefix("the ") in alarm
