"""Runs that are killed after some checkpoints, in forks of this process, which has compiled everything already."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import mbdkit
import mbdkit.runs.run_checkpoint
from mbdkit.archive import writer
from mbdkit.integrators import interface

PATIENCE = 60.0
"""Time for a fork to write its checkpoints [s]."""


def make_frequent() -> None:
    """Let runs of this process return from compiled code, flush and write checkpoints every few milliseconds."""
    interface.STRETCH = 0.002
    writer.FLUSH_INTERVAL = 0.004
    mbdkit.runs.run_checkpoint.INTERVAL, mbdkit.runs.run_checkpoint.SHARE = 0.003, 1e9


def killed(spec: dict[str, Any] | None, part: Path, *, checkpoints: int = 2, delay: float = 0.02) -> bool:
    """Start a run, or resume the one of `part` without a spec, and kill it; return whether it was still going.

    Parameters
    ----------
    checkpoints
        Number of checkpoints after which it is killed.
    delay
        Largest time until then [s], which is chosen at random.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            make_frequent()
            write = writer.ArchiveWriter.keep_checkpoint

            def noted(self: Any, state: Any) -> None:
                write(self, state)
                os.write(writing, b".")

            writer.ArchiveWriter.keep_checkpoint = noted  # type: ignore[method-assign]
            if spec is None:
                mbdkit.resume(part)
            else:
                mbdkit.run(spec, archive=part.with_suffix(""))
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb", buffering=0) as told:
        seen = 0
        while seen < checkpoints and (piece := told.read(checkpoints - seen)):
            seen += len(piece)
        time.sleep(random.uniform(0.0, delay))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    return part.exists()
