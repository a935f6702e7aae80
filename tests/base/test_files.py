"""A file is written whole or not at all, and only a regular file is ever replaced."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from mbdkit.base import files
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.files import check_output, read_bytes, replacing
from tests.tiny_disk import tiny_disk


def sock(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as end:
        end.bind(str(path))


def link(path: Path) -> None:
    path.with_name("precious").write_text("precious")
    path.symlink_to("precious")


SPECIAL: dict[str, Callable[[Path], None]] = {
    "pipe": os.mkfifo,
    "socket": sock,
    "symbolic link": link,
    "dangling link": lambda path: path.symlink_to("nowhere"),
    "link to a device": lambda path: path.symlink_to("/dev/null"),
    "folder": Path.mkdir,
}


@pytest.mark.parametrize("kind", SPECIAL)
def test_only_regular_files_are_replaced(in_tmp_path: Path, kind: str) -> None:
    path = Path("out.txt")
    SPECIAL[kind](path)
    before = path.lstat().st_ino
    with pytest.raises(SpecError, match=r"is not replaced|this is a folder"), replacing(path) as temporary:
        temporary.write_text("new")
    assert path.lstat().st_ino == before
    assert not Path("precious").exists() or Path("precious").read_text() == "precious"


def test_the_input_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "spec.yaml"
    path.write_text("precious")
    os.link(path, tmp_path / "same.yaml")
    with pytest.raises(SpecError, match="is the input"):
        check_output(tmp_path / "same.yaml", overwrite=True, source=path)


@pytest.mark.parametrize("overwrite", [True, False])
def test_a_failure_leaves_what_was_there(tmp_path: Path, overwrite: bool) -> None:
    path = tmp_path / "out.txt"
    if overwrite:
        path.write_text("before")
    with pytest.raises(ZeroDivisionError), replacing(path, overwrite=overwrite) as temporary:
        print(temporary.write_text("half") / 0)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["before"] * overwrite


def test_a_file_that_appears_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    with pytest.raises(SpecError, match="created meanwhile"), replacing(path, overwrite=False):
        path.write_text("theirs")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["theirs"]


def test_what_a_killed_process_left_is_removed_and_what_a_running_one_writes_is_not(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    script = (
        "import sys, time; from pathlib import Path; from mbdkit.base.files import replacing\n"
        "with replacing(Path(sys.argv[1])): print('in', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", script, path], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        (left,) = tmp_path.iterdir()
        assert left.name.startswith(".out-")
        with replacing(path) as temporary:
            temporary.write_text("first")
        assert left.exists()
        process.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 10
    while left.exists() and time.monotonic() < deadline:
        with replacing(path) as temporary:
            temporary.write_text("second")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["second"]


def test_a_temporary_file_removed_before_it_is_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    locked, removed = files._locked, list[Path]()

    def late(handle: int, **options: bool) -> bool:
        if not removed:
            removed.extend(tmp_path.iterdir())
            removed[0].unlink()  # as another process does with the file of a killed one
        return locked(handle, **options)

    monkeypatch.setattr(files, "_locked", late)
    with replacing(tmp_path / "out.txt") as temporary:
        assert temporary.exists()
        temporary.write_text("whole")
    assert [file.name for file in tmp_path.iterdir()] == ["out.txt"]
    assert (tmp_path / "out.txt").read_text() == "whole"


def test_a_full_disk_leaves_what_was_there(tmp_path: Path) -> None:
    with tiny_disk(tmp_path / "disk", 64) as disk:
        path = disk / "out.txt"
        path.write_text("before")
        with pytest.raises(MbdkitError, match="No space left"), replacing(path) as temporary:
            temporary.write_bytes(bytes(1 << 20))
        assert [file.read_text() for file in disk.iterdir()] == ["before"]


@pytest.mark.parametrize("kind", ["pipe", "link to a device", "folder"])
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_only_regular_files_are_opened(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "model.xml"
    {"pipe": os.mkfifo, "link to a device": lambda link: link.symlink_to("/dev/zero"), "folder": os.mkdir}[kind](path)
    monkeypatch.setattr(os, "open", lambda *arguments: pytest.fail("the file was opened"))
    with pytest.raises(SpecError, match=r"model\.xml: this is not a regular file but a .*; it is not read"):
        read_bytes(path, 100)


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs a file whose stated size is wrong")
def test_the_bytes_that_are_read_are_counted_and_not_those_that_the_system_states() -> None:
    maps = Path("/proc/self/maps")
    assert maps.stat().st_size == 0
    with pytest.raises(SpecError, match="this file is larger than 0 MiB, the limit for files of this kind; shorten it"):
        read_bytes(maps, 100, "shorten it")


def test_a_file_up_to_the_limit_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"123")
    assert read_bytes(tmp_path / "a", 3) == b"123"
    with pytest.raises(SpecError):
        read_bytes(tmp_path / "a", 2)
    with pytest.raises(SpecError, match="this file cannot be read: No such file or directory"):
        read_bytes(tmp_path / "b", 2)


@pytest.mark.parametrize("name", ["a\0b.csv", "a\ud800b.csv"])
def test_names_that_no_file_can_have_are_refused(name: str, tmp_path: Path) -> None:
    for use in (lambda path: read_bytes(path, 1), lambda path: check_output(path, overwrite=False)):
        with pytest.raises(SpecError, match="no file can have this name"):
            use(tmp_path / name)
