"""What a user waits for before anything moves: the import, the command line, a small run, the compile on first use."""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from .timing import duration, take_turns

REPEATS = 7
SPEC = """mbdkit: 1
model: {name: double-pendulum}
integrator: {name: gauss, stages: 2}
time: {end: 5.0, step: 0.01}
"""


def timed(arguments: list[str], folder: Path) -> float:
    """Return the seconds that a Python process with `arguments` takes."""
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True, cwd=folder)
    return time.perf_counter() - start


def startup(console: Console) -> None:
    """Print the times of whole processes."""
    table = Table(title=f"Start-up: whole processes, medians of {REPEATS}")
    table.add_column("what")
    table.add_column("time", justify="right")
    table.add_column("without Python itself", justify="right")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "small.yaml").write_text(SPEC)
        run = ["-m", "mbdkit", "run", "small.yaml", "--overwrite", "--quiet"]
        commands = {
            "python -c pass": ["-c", "pass"],
            "import mbdkit": ["-c", "import mbdkit"],
            "mbdkit --help": ["-m", "mbdkit", "--help"],
            "mbdkit run small.yaml": run,
        }
        timings = take_turns(
            {what: functools.partial(timed, arguments, folder) for what, arguments in commands.items()}, REPEATS
        )
        bare = timings["python -c pass"].median
        for what, timing in timings.items():
            table.add_row(what, duration(timing.median), duration(max(timing.median - bare, 0.0)))
    console.print(table)
