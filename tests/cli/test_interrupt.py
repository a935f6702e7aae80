"""A long run on a terminal and under Ctrl-C."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import mbdkit
from mbdkit import load
from mbdkit.base import interrupts
from mbdkit.base.interrupts import interrupts_noted
from tests.forked_process import ForkedProcess, forked_command

pytestmark = pytest.mark.end_to_end

LONG = """\
mbdkit: 1
model: {name: n-pendulum, n: 20}
integrator: {name: rk4}
time: {end: 1.0e+6, step: 1.0e-3}
output: {every: 1000}
limits: {max_steps: 2000000000}
"""


def start(folder: Path, *arguments: str, hangup: signal.Handlers = signal.SIG_DFL, **options) -> ForkedProcess:
    (folder / "long.yaml").write_text(LONG)
    before = signal.signal(signal.SIGHUP, hangup)  # the tests themselves may run under nohup
    try:
        return forked_command("run", "long.yaml", *arguments, folder=folder, **options)
    finally:
        signal.signal(signal.SIGHUP, before)


def wait_until_it_runs(process: subprocess.Popen | ForkedProcess, part: Path) -> None:
    """Wait until rows have been flushed.

    The file may also be seen to grow while it is created, before there are rows and before the run notes signals.
    """
    deadline, wanted = time.monotonic() + 300, 6 if isinstance(process, ForkedProcess) else 2
    size, grown = None, 0
    while time.monotonic() < deadline and process.poll() is None:
        if part.exists():
            size, before = part.stat().st_size, size
            grown += before is not None and size > before
            if grown >= wanted:
                return
        time.sleep(0.01)
    pytest.fail("the run did not get under way")


@pytest.mark.parametrize("stop", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_ctrl_c_and_its_like_keep_the_archive_and_are_exit_status_130(stop, tmp_path):
    if stop == "SIGINT":  # a process of its own, as users start it
        (tmp_path / "long.yaml").write_text(LONG)
        command = [sys.executable, "-m", "mbdkit", "run", "long.yaml"]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    else:
        process = start(tmp_path)
    try:
        wait_until_it_runs(process, tmp_path / "long.h5.part")
        process.send_signal(getattr(signal, stop))
        if stop == "SIGTERM":  # as `timeout` does
            process.send_signal(signal.SIGTERM)
        told, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "interrupted: stopped by the user" in told
    assert "Traceback" not in errors
    assert sorted(os.listdir(tmp_path)) == ["long.h5", "long.h5.checkpoint", "long.yaml"]
    with load(tmp_path / "long.h5") as run:
        assert run.status == "interrupted"
        assert len(run.time) > 1


def test_a_run_under_nohup_goes_on(tmp_path):
    process = start(tmp_path, hangup=signal.SIG_IGN)
    try:
        wait_until_it_runs(process, tmp_path / "long.h5.part")
        process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            process.communicate(timeout=0.4)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130


def test_a_program_of_the_user_is_ended_by_sigterm_after_its_archive_is_complete(tmp_path):
    (tmp_path / "long.yaml").write_text(LONG)

    def program() -> None:
        mbdkit.run("long.yaml", archive="long.h5")
        print("went on")

    process = ForkedProcess(program, tmp_path)
    try:
        wait_until_it_runs(process, tmp_path / "long.h5.part")
        process.send_signal(signal.SIGTERM)
        told, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == -signal.SIGTERM
    assert told == ""
    with load(tmp_path / "long.h5") as run:
        assert run.status == "interrupted"


def interpreted() -> None:
    x = 1
    while x > 0:
        x += 1


def compiled() -> None:
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)  # minutes of C code without the lock of the interpreter


@pytest.mark.parametrize("endless", [compiled, interpreted])
def test_the_second_sigterm_ends_an_endless_loop(endless, tmp_path, monkeypatch):
    monkeypatch.setattr(interrupts, "TOGETHER", 0.2)

    def program() -> None:
        with interrupts_noted(lambda: None):
            Path("ready").touch()
            endless()

    process = ForkedProcess(program, tmp_path)
    try:
        while not (tmp_path / "ready").exists():
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=0.4)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=10) == 130
    finally:
        process.kill()


def test_signals_are_those_of_before_after_a_run(tmp_path):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with interrupts_noted(lambda: None):
        assert signal.getsignal(signal.SIGTERM) != before[1]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before
    assert signal.set_wakeup_fd(-1) == -1


def test_ctrl_break_stops_a_run_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGUSR1 stands in for SIGBREAK."""
    monkeypatch.setattr(signal, "SIGBREAK", signal.SIGUSR1, raising=False)
    spec = importlib.util.spec_from_file_location("interrupts_on_windows", interrupts.__file__)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    events: list[str] = []
    before = signal.signal(signal.SIGUSR1, lambda *_: events.append("passed to the program"))
    try:
        with module.interrupts_noted(lambda: events.append("noted")):
            signal.raise_signal(signal.SIGUSR1)
            events.append("archive completed")
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert events == ["noted", "archive completed", "passed to the program"]


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_terminal_sees_a_progress_bar(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    import pty

    master, slave = pty.openpty()
    process = start(tmp_path, stderr=slave)
    os.close(slave)
    drawn, until = "", time.monotonic() + 60
    try:
        while "of 1e+06 s" not in drawn and time.monotonic() < until:
            drawn += os.read(master, 100_000).decode(errors="ignore")
        process.send_signal(signal.SIGINT)
        process.wait(timeout=60)
    finally:
        process.kill()
        os.close(master)
    assert "of 1e+06 s" in drawn
