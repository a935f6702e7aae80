"""What an attack is, and how one of its cases is run: in a process of its own, with its time and memory measured."""

from __future__ import annotations

import importlib.util
import os
import pickle
import select
import signal
import subprocess
import sys
import time
import traceback
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

SECONDS = 5.0
"""Nothing may take longer than this to refuse what is bad."""

LONGEST_MESSAGE = 8000
"""Characters of an error message that somebody may read."""

MEMORY = 1 << 30
"""Nothing may take more resident memory than this to refuse what is bad [bytes]."""


@dataclass(frozen=True)
class Attack:
    """One kind of attack; every file of this folder with a constant `ATTACKS` supplies some.

    Parameters
    ----------
    name
        Short name, used on the command line.
    summary
        One line: what is done, and what must hold.
    cases
        Number of cases of the whole campaign.
    case
        ``case(random, folder)`` makes one attack in an empty folder and returns the sentences that say what did not
        hold; none if all held.
    needs
        Modules without which the attack cannot be made.
    """

    name: str
    summary: str
    cases: int
    case: Callable[[np.random.Generator, Path], list[str]]
    needs: tuple[str, ...] = ()

    @property
    def obstacle(self) -> str:
        """The sentence that says why the attack cannot be made; empty if it can."""
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        return f"{self.name} is not attempted, because {', '.join(missing)} cannot be imported" if missing else ""

    def random(self, seed: int, index: int) -> np.random.Generator:
        """Return the generator of random numbers of a case: it depends on the seed, the attack and the index alone."""
        return np.random.default_rng([seed, zlib.crc32(self.name.encode()), index])


@dataclass(frozen=True)
class Ending:
    """How a process ended.

    Attributes
    ----------
    exit_status
        Exit status; negative: the number of the signal that ended it. None: it was killed because its time was up.
    seconds
        Wall time [s].
    memory
        Largest resident memory [bytes]; after `in_child`, what it took beyond that of this process.
    output, errors
        Standard output and standard error.
    value
        What the function returned (`in_child` only).
    cpu
        Processor time [s], which does not depend on what else the machine does.
    """

    exit_status: int | None
    seconds: float
    memory: int
    output: str = ""
    errors: str = ""
    value: Any = None
    cpu: float = 0.0

    def problems(self, *, allowed: Sequence[int] = (0, 2, 3, 4), what: str = "it") -> list[str]:
        """Return what did not hold: crash, hang, memory, a traceback, an exit status that is not allowed."""
        said = self.errors.strip().splitlines()[-1:] or [""]
        if self.exit_status is None:
            return [f"{what} did not end in {self.seconds:.0f} s"]
        found = []
        if self.exit_status not in allowed:
            found.append(f"{what} ended with exit status {self.exit_status}: {said[0][:200]}")
        if "Traceback (most recent call last)" in self.errors or "bug in mbdkit" in self.errors:
            found.append(f"{what} ended with an exception of its own: {said[0][:200]}")
        if self.cpu > SECONDS:
            found.append(f"{what} took {self.cpu:.1f} s")
        if self.memory > MEMORY:
            found.append(f"{what} took {self.memory / 2**20:.0f} MiB")
        return found


def command(*arguments: str | Path, folder: Path, seconds: float = 12 * SECONDS, **more: Any) -> Ending:
    """Run ``mbdkit ARGUMENTS`` in a folder; `more` goes to `subprocess.Popen`."""
    out, err = folder / ".out", folder / ".err"
    start = time.monotonic()
    with out.open("wb") as output, err.open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "mbdkit", *map(str, arguments)],
            cwd=folder,
            **({"stdin": subprocess.DEVNULL, "stdout": output, "stderr": errors} | more),
        )
        status, usage, cpu = wait_for(process.pid, start + seconds)
        process.returncode = -signal.SIGKILL if status is None else status
    ending = Ending(
        status,
        time.monotonic() - start,
        usage,
        out.read_text(errors="replace"),
        err.read_text(errors="replace"),
        cpu=cpu,
    )
    out.unlink()
    err.unlink()
    return ending


def in_child(function: Callable[..., Any], *arguments: Any, seconds: float = 12 * SECONDS) -> Ending:
    """Call a function in a fork of this process, which has imported everything already.

    An exception ends the child with exit status 1 and its traceback in `errors`; callers catch what is expected.
    """
    read, write = os.pipe()
    start = time.monotonic()
    shared = resident_memory()
    child = os.fork()
    if child == 0:
        os.close(read)
        status = 0
        try:
            answer = pickle.dumps((function(*arguments), ""))
        except BaseException:
            answer, status = pickle.dumps((None, traceback.format_exc())), 1
        with os.fdopen(write, "wb") as pipe:
            pipe.write(answer)
        os._exit(status)
    os.close(write)
    answer = b""
    with os.fdopen(read, "rb", buffering=0) as pipe:
        while (left := start + seconds - time.monotonic()) > 0 and select.select([pipe], [], [], left)[0]:
            piece = pipe.read(1 << 16)
            if not piece:
                break
            answer += piece
    result, memory, cpu = wait_for(child, start + seconds)
    value, errors = pickle.loads(answer) if answer and result in (0, 1) else (None, "")
    return Ending(result, time.monotonic() - start, max(0, memory - shared), errors=errors, value=value, cpu=cpu)


def resident_memory() -> int:
    """Return the resident memory of this process [bytes]; a fork of it begins with as much."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def wait_for(child: int, until: float) -> tuple[int | None, int, float]:
    """Return how a child ended.

    Returns
    -------
    tuple
        Exit status, or None if it had to be killed; largest resident memory [bytes]; processor time [s].
    """
    killed, memory = False, 0
    while True:
        # not the usage that the system reports at the end, which begins with the memory of this process
        memory = max(memory, _peak_memory(child))
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return None if killed else code, memory, usage.ru_utime + usage.ru_stime
        if not killed and time.monotonic() > until:
            os.kill(child, signal.SIGKILL)
            killed = True
        time.sleep(0.002)


def _peak_memory(process: int) -> int:
    """Return the largest resident memory of a process since it began its program [bytes]; 0 if it has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM:")), 0)
