"""Commands that read an archive refuse it if it was changed after it was written."""

from __future__ import annotations

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


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_refuse_an_archive_whose_data_were_scaled(mbdkit, in_tmp_path, command):
    run("pendulum", time={"end": 0.1, "step": 0.01}, archive="run.h5").close()
    assert mbdkit(*COMMANDS[command]).exit_code == 0
    with h5py.File("run.h5", "a") as file:
        file[path := "trajectory/position" if command == "animate" else "joints/reaction_force"][...] *= 1e-3
    overwrite = () if command == "archive info" else ("--overwrite",)
    changed = mbdkit(*COMMANDS[command], *overwrite)
    assert changed.exit_code == 2
    assert "this file is damaged, " in changed.output
    assert f"({path} has changed since it was written)" in changed.output
