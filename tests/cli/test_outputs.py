"""What commands write replaces regular files only, and nothing when it fails."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.archive.making import make
from tests.slow_cases import slow, slow_but
from tests.tiny_disk import tiny_disk

COMMANDS = {
    "kinematics": ("kinematics", "pendulum", "--overwrite", "-o"),
    "equilibrium": ("equilibrium", "pendulum", "--overwrite", "--write"),
    "examples copy": ("examples", "copy", "pendulum", "-o"),
    "plot": ("plot", "run.h5", "-o"),
    "animate": ("animate", "run.h5", "-o"),
    "report": ("report", "run.h5", "--overwrite", "-o"),
    "modes": ("modes", "pendulum", "-o"),
    "run": ("run", "pendulum", "--overwrite", "-o"),
    "rerun": ("rerun", "run.h5", "--overwrite", "-o"),
}
SUFFIX = {"animate": ".gif", "report": ".html", "run": ".h5", "rerun": ".h5"}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", ["pipe", "link to a device"])
def test_pipes_and_devices_are_not_replaced(mbdkit, in_tmp_path, command, kind):
    make(Path("run.h5"))
    target = Path(f"out{SUFFIX.get(command, '.png')}")
    os.mkfifo(target) if kind == "pipe" else target.symlink_to("/dev/null")
    before = target.lstat()
    result = mbdkit(*COMMANDS[command], target)
    assert result.exit_code == 2
    assert "not a regular file" in result.stderr
    assert (target.lstat().st_ino, target.lstat().st_mode) == (before.st_ino, before.st_mode)


PICTURES = {"plot": "run.h5", "animate": "run.h5", "modes": "pendulum"}


@pytest.mark.parametrize("command", slow_but(PICTURES, "plot", "modes"))
def test_a_picture_is_replaced_only_with_overwrite(mbdkit, in_tmp_path, command):
    words = command, PICTURES[command]
    assert mbdkit("run", "pendulum", "-o", "run.h5").exit_code == 0
    old = Path("old.gif" if command == "animate" else "old.png")
    old.write_text("precious")
    result = mbdkit(*words, "-o", old)
    assert result.exit_code == 2
    assert "this file exists already" in result.stderr
    assert old.read_text() == "precious"
    assert mbdkit(*words, "-o", old, "--overwrite").exit_code == 0
    assert old.stat().st_size > 1000


@pytest.mark.parametrize("command", ["kinematics", "equilibrium"])
def test_a_device_itself_is_not_replaced(mbdkit, command):
    result = mbdkit(*COMMANDS[command], "/dev/null")
    assert result.exit_code == 2
    assert "not a regular file" in result.stderr
    assert Path("/dev/null").is_char_device()


def test_a_copy_onto_a_full_disk_leaves_nothing(mbdkit, tmp_path):
    with tiny_disk(tmp_path / "disk", 16) as disk:
        ballast = disk / "ballast"
        with ballast.open("wb") as file, pytest.raises(OSError, match="No space left"):
            file.write(bytes(1 << 20))
        result = mbdkit("examples", "copy", "knee", "-o", disk / "knee.yaml")
        assert result.exit_code != 0
        assert "No space left" in result.stderr
        assert list(disk.iterdir()) == [ballast]


@pytest.mark.parametrize("suffix", ["svg", *slow("png", "pdf")])
def test_a_picture_onto_a_full_disk_leaves_the_old_one(mbdkit, tmp_path, suffix):
    assert mbdkit("run", "pendulum", "-o", tmp_path / "run.h5").exit_code == 0
    with tiny_disk(tmp_path / "disk", 64) as disk:
        old = disk / f"old.{suffix}"
        old.write_text("precious")
        with (disk / "ballast").open("wb") as file, pytest.raises(OSError, match="No space left"):
            file.write(bytes(1 << 20))
        result = mbdkit("plot", str(tmp_path / "run.h5"), "-o", str(old), "--overwrite")
        assert result.exit_code == 3, result.stderr
        assert "No space left" in result.stderr
        assert old.read_text() == "precious"
        assert {path.name for path in disk.iterdir()} == {"ballast", old.name}
