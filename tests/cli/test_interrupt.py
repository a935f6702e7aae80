"""A long run on a terminal and under Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from mbdkit import load
from mbdkit.base.interrupts import TOGETHER, interrupts_noted

LONG = """\
mbdkit: 1
model: {name: n-pendulum, n: 20}
integrator: {name: rk4}
time: {end: 1.0e+6, step: 1.0e-3}
output: {every: 1000}
limits: {max_steps: 2000000000}
"""


def start(folder: Path, *arguments: str, **options) -> subprocess.Popen:
    (folder / "long.yaml").write_text(LONG)
    return subprocess.Popen([sys.executable, "-m", "mbdkit", "run", "long.yaml", *arguments], cwd=folder, **options)


def wait_until_it_runs(process: subprocess.Popen, part: Path) -> None:
    """Wait until rows have been flushed: a first run may compile for a minute before."""
    deadline = time.monotonic() + 300
    size = None
    while time.monotonic() < deadline and process.poll() is None:
        if part.exists():
            size, before = part.stat().st_size, size
            if before is not None and size > before:
                return
        time.sleep(0.3)
    pytest.fail("the run did not get under way")


@pytest.mark.parametrize("stop", ["SIGINT", "SIGTERM", pytest.param("SIGHUP", marks=pytest.mark.slow)])
def test_ctrl_c_and_its_like_keep_the_archive_and_are_exit_status_130(stop, tmp_path):
    process = start(tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
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
    assert sorted(os.listdir(tmp_path)) == ["long.h5", "long.yaml"]
    with load(tmp_path / "long.h5") as run:
        assert run.status == "interrupted"
        assert len(run.time) > 1


def test_a_run_under_nohup_goes_on(tmp_path):
    process = start(tmp_path, stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    try:
        wait_until_it_runs(process, tmp_path / "long.h5.part")
        process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            process.communicate(timeout=1)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130


def run_script(text: str, folder: Path) -> subprocess.Popen:
    """Start a script that says `ready` before it goes on."""
    script = folder / "script.py"
    script.write_text(textwrap.dedent(text))
    process = subprocess.Popen([sys.executable, script], cwd=folder, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def test_a_program_of_the_user_is_ended_by_sigterm_after_its_archive_is_complete(tmp_path):
    (tmp_path / "long.yaml").write_text(LONG)
    process = run_script(
        """
        import mbdkit
        print("ready", flush=True)
        mbdkit.run("long.yaml", archive="long.h5")
        print("went on")
        """,
        tmp_path,
    )
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


@pytest.mark.parametrize("how", ["compiled", "interpreted"])
def test_the_second_sigterm_ends_an_endless_loop(how, tmp_path):
    process = run_script(
        f"""
        from numba import njit
        from mbdkit.base.interrupts import interrupts_noted

        def endless(x):
            while x > 0:
                x += 1
            return x

        if {how == "compiled"}:
            endless = njit("int64(int64)", nogil=True)(endless)  # as kernels are
        with interrupts_noted(lambda: None):
            print("ready", flush=True)
            endless(1)
        """,
        tmp_path,
    )
    try:
        process.send_signal(signal.SIGTERM)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=TOGETHER + 0.3)
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


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_terminal_sees_a_progress_bar(tmp_path):
    import pty

    master, slave = pty.openpty()
    process = start(tmp_path, stdout=subprocess.DEVNULL, stderr=slave, env=os.environ | {"TERM": "xterm"})
    os.close(slave)
    try:
        wait_until_it_runs(process, tmp_path / "long.h5.part")
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        process.wait(timeout=60)
        drawn = os.read(master, 100_000).decode(errors="ignore")
    finally:
        process.kill()
        os.close(master)
    assert "of 1e+06 s" in drawn
