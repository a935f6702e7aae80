"""Locks of open files on POSIX and, by imitation of its rules, on Windows."""

from __future__ import annotations

import os
from contextlib import ExitStack
from pathlib import Path

import pytest

from mbdkit.base import file_locks, files, memory, windows_calls
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.base.files import check_output, rename_new, replace_file, replacing
from tests.windows_rules import ACCESS_DENIED, SHARING_VIOLATION, Kernel32, obey_windows, refusal


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> Kernel32:
    monkeypatch.setattr(files, "PATIENCE", 0.05)
    return obey_windows(monkeypatch)


@pytest.fixture(params=["posix", "windows"])
def system(request: pytest.FixtureRequest) -> str:
    if request.param == "windows":
        request.getfixturevalue("windows")
    return str(request.param)


@pytest.mark.usefixtures("system")
def test_exclusive_locks_exclude_all_others_and_shared_locks_exclude_exclusive_ones(tmp_path: Path) -> None:
    (tmp_path / "a").touch()
    first, second = (file_locks.open_file(tmp_path / "a", os.O_RDWR) for _ in range(2))
    file_locks.lock(first)
    for shared in (True, False):
        with pytest.raises(BlockingIOError):
            file_locks.lock(second, shared=shared)
    assert file_locks.is_locked(tmp_path / "a")
    file_locks.unlock(first)
    file_locks.lock(first, shared=True)
    file_locks.lock(second, shared=True)
    assert not file_locks.is_locked(tmp_path / "a")
    os.close(second)
    with pytest.raises(BlockingIOError):
        file_locks.lock(file_locks.open_file(tmp_path / "a", os.O_RDWR))
    os.close(first)
    file_locks.lock(file_locks.open_file(tmp_path / "a", os.O_RDWR))


@pytest.mark.usefixtures("system")
def test_a_removed_or_replaced_file_no_longer_has_its_name(tmp_path: Path) -> None:
    path, other = tmp_path / "a", tmp_path / "b"
    handle = file_locks.open_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL)
    assert file_locks.has_name(handle, path)
    os.rename(path, other)
    path.touch()
    assert not file_locks.has_name(handle, path)
    assert file_locks.has_name(handle, other)
    other.unlink()
    assert not file_locks.has_name(handle, other)


def test_windows_locks_no_byte_that_a_file_can_have(windows: Kernel32, tmp_path: Path) -> None:
    """Locked bytes could not be read through other handles; 2^62 bytes are more than NTFS and ReFS allow."""
    with replacing(tmp_path / "a") as temporary:
        temporary.write_text("whole")
    assert windows.positions == {(0, 1 << 30)}
    assert (tmp_path / "a").read_text() == "whole"


@pytest.mark.usefixtures("windows")
def test_a_file_that_another_program_has_open_is_named_and_nothing_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    path.write_text("before")
    with path.open(), pytest.raises(ResourceError, match="is open in this or another program"), replacing(path):
        pytest.fail("the work was done in vain")

    def write(programs: ExitStack) -> None:
        with replacing(path) as temporary:
            temporary.write_text("after")
            programs.enter_context(path.open())

    words = r"cannot be written: out\.txt is open in this or another program"
    with ExitStack() as programs, pytest.raises(ResourceError, match=words):
        write(programs)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["before"]


@pytest.mark.parametrize("number", [ACCESS_DENIED, SHARING_VIOLATION])
def test_a_file_that_a_virus_scanner_opens_for_a_moment_is_replaced(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, refused = os.replace, iter([number] * 3)

    def late(source: Path, target: Path) -> None:
        for one in refused:
            raise refusal(one, target)
        replace(source, target)

    monkeypatch.setattr(os, "replace", late)
    (tmp_path / "a").write_text("whole")
    replace_file(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_text() == "whole"


def test_a_lack_of_permission_is_reported_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts = []

    def refuse(*paths: Path) -> None:
        attempts.append(paths)
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(PermissionError, match="Permission denied"):
        replace_file(tmp_path / "a", tmp_path / "b")
    assert len(attempts) == 1


@pytest.mark.usefixtures("system")
def test_renaming_to_a_new_name_replaces_nothing(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("new")
    (tmp_path / "b").write_text("precious")
    with pytest.raises(FileExistsError):
        rename_new(tmp_path / "a", tmp_path / "b")
    rename_new(tmp_path / "a", tmp_path / "c")
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {"b": "precious", "c": "new"}


@pytest.mark.parametrize(
    "name", ["con.h5", "NUL", "Com1.tar.gz", "lpt\u00b9.h5", "run:1.h5", "a?.h5", "run.", "run.h5 "]
)
def test_names_that_windows_takes_for_something_else_are_refused_there(
    name: str, windows: Kernel32, tmp_path: Path
) -> None:
    with pytest.raises(SpecError, match="Windows does not allow this name"):
        check_output(tmp_path / name, overwrite=True)


@pytest.mark.parametrize("name", ["console.h5", "com10.h5", ".lock", "a.con", "nul1", "run (2).h5", "\u00b5.h5"])
@pytest.mark.usefixtures("windows")
def test_names_that_only_resemble_devices_are_allowed(name: str, tmp_path: Path) -> None:
    check_output(tmp_path / name, overwrite=False)


def test_memory_and_processes_are_queried_as_windows_documents(windows: Kernel32) -> None:
    assert (memory.installed_memory(), memory.available_memory()) == (16 << 30, 5 << 30)
    assert windows_calls.process_start(os.getpid()) == str((1 << 32) + os.getpid())
    assert windows_calls.process_start(2**22 + 1) == ""
