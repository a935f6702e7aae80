"""A long run on a terminal and under Ctrl-C."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mbdkit import load

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


def test_ctrl_c_keeps_the_archive_and_is_exit_status_130(tmp_path):
    process = start(tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_until_it_runs(process, tmp_path / "long.h5.part")
        process.send_signal(signal.SIGINT)
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
