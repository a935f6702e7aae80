"""The command ends without tearing down the interpreter, and still nothing is lost."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

BEFORE = """
import atexit, sys, threading, time
from pathlib import Path
left_open = open("left-open.txt", "w")
left_open.write("all of it")
atexit.register(lambda: Path("handler.txt").write_text("called"))
if "{thread}":
    threading.Thread(target=lambda: (time.sleep(0.2), Path("thread.txt").write_text("done"))).start()
sys.argv = ["mbdkit", *{words}]
from mbdkit.cli import run_and_exit
run_and_exit()
"""


WITHIN = """
import os, sys
import mbdkit.cli as cli

def app(prog_name):
    print("printed by a plugin")
    cli.left_open = os.fdopen(os.dup(1), "w"), os.fdopen(int(sys.argv[1]), "w")
    for stream in cli.left_open:
        stream.write("left open")

cli.app = app
cli.run_and_exit()
"""


def run(folder: Path, *words: str, thread: str = "") -> subprocess.CompletedProcess[str]:
    script = BEFORE.format(words=list(words), thread=thread)
    return subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True)


def test_files_and_handlers_are_finished_before_the_process_ends(tmp_path: Path) -> None:
    done = run(tmp_path, "--version")
    assert (done.returncode, done.stdout[:6]) == (0, "mbdkit")
    assert (tmp_path / "left-open.txt").read_text() == "all of it"
    assert (tmp_path / "handler.txt").read_text() == "called"


def test_threads_are_waited_for_and_statuses_kept(tmp_path: Path) -> None:
    done = run(tmp_path, "run", "no-such-example", thread="yes")
    assert (done.returncode, done.stdout) == (2, "")
    assert (tmp_path / "thread.txt").read_text() == "done"


def test_streams_that_a_plugin_opens_are_flushed() -> None:
    reader, writer = os.pipe()
    done = subprocess.run(
        [sys.executable, "-c", WITHIN, str(writer)], pass_fds=[writer], capture_output=True, text=True
    )
    os.close(writer)
    with os.fdopen(reader) as stream:
        assert stream.read() == "left open"
    assert done.stdout + done.stderr == "printed by a plugin\nleft open"
