"""Parts (shards) of a study, and the locks that prevent conflicts of calls in one folder; each call has a lock file."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import secrets
import socket
import subprocess
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from mbdkit.base import file_locks
from mbdkit.base.errors import ResourceError, SpecError
from mbdkit.base.files import rename_new
from mbdkit.base.text import shown


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of a study.

    Parameters
    ----------
    number, count
        Number of the part, from 1, and number of parts. The runs of the study, or its blocks of runs, are assigned to
        the parts in turn.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse a part from text such as ``2/3``.

        Raises
        ------
        SpecError
            If the text does not have this form, or the number is not from 1 to the count.
        """
        match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
        if not match or not 1 <= int(match[1]) <= int(match[2]):
            raise SpecError(f"a part of a study should be given as NUMBER/COUNT, such as 1/2, not {text!r}")
        return cls(int(match[1]), int(match[2]))

    def has(self, place: int) -> bool:
        """Return whether the run or block with this index, from 0, belongs to the part."""
        return place % self.count == self.number - 1

    def overlaps(self, other: Shard) -> bool:
        """Return whether some index, however large, belongs to both parts."""
        return (self.number - other.number) % math.gcd(self.count, other.count) == 0


WHOLE = Shard(1, 1)  #: The whole study as a single part.


LOCK = ".lock-"  #: Prefix of the names of lock files.

_NAME = re.compile(re.escape(LOCK) + r"(\d{1,6})-of-(\d{1,6})")

_BOOT = Path("/proc/sys/kernel/random/boot_id")


@dataclass(frozen=True)
class Owner:
    """The process that holds a lock.

    Parameters
    ----------
    host
        Name of its machine.
    boot
        Identifier of the last boot of the machine; empty if unknown. Since then, process number and `started` together
        are unique.
    started
        Start time of the process, as reported by the system.
    since
        Time at which the process took the lock, as text.
    token
        Text that distinguishes this lock from other locks of the process.
    """

    host: str
    boot: str
    pid: int
    started: str
    since: str
    token: str

    @classmethod
    def this_process(cls) -> Owner:
        """Return the owner for locks that this process takes."""
        since = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        return cls(socket.gethostname(), _boot(), os.getpid(), _started(os.getpid()), since, secrets.token_hex(4))

    @classmethod
    def of(cls, lock: Path) -> Owner | None:
        """Return the owner of a lock; None if the file does not exist, or is not readable as a lock."""
        try:
            handle = file_locks.open_file(lock, os.O_RDONLY | file_locks.NO_LINKS)
            with os.fdopen(handle, "rb") as file:
                content = json.loads(file.read(4096))
            texts = {field.name: str(content[field.name]) for field in fields(cls) if field.name != "pid"}
            return cls(pid=int(content["pid"]), **texts)
        except (OSError, ValueError, KeyError, TypeError):
            return None

    @property
    def is_here(self) -> bool:
        """Whether the process runs, or ran, on this machine."""
        return self.host == socket.gethostname()

    @property
    def is_dead(self) -> bool:
        """Whether the process is known to have ended; this can be determined on its own machine only."""
        return self.is_here and (self.boot != _boot() or self.started != _started(self.pid))


def _boot() -> str:
    try:
        return _BOOT.read_text("ascii").strip()
    except OSError:
        return ""


def _started(pid: int) -> str:
    """Return when a process started, as text; empty if it has ended."""
    if _BOOT.exists():  # Linux
        try:
            # The fields follow the name of the program in parentheses, which may itself contain spaces and parentheses.
            status = Path(f"/proc/{pid}/stat").read_text("utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:
            return ""
        return "" if status[0] in "ZX" else status[19]  # a dead process that its parent has not waited for, see proc(5)
    if file_locks.IS_WINDOWS:
        from mbdkit.base.windows_calls import process_start

        return process_start(pid)
    command = ["ps", "-o", "stat=", "-o", "lstart=", "-p", str(pid)]
    # The output depends on language and time zone, which may differ between two calls.
    environment = os.environ | {"LC_ALL": "C", "TZ": "UTC"}
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    state, _, started = process.stdout.strip().partition(" ")
    return "" if state.startswith("Z") else started.strip()


@contextlib.contextmanager
def locked(folder: Path, mutex: Path, shard: Shard = WHOLE, command: str = "study") -> Iterator[None]:
    """Hold the lock on a part of a study, or on the folder of a design, and release it at the end of the block.

    If the owner of a lock has died on this machine, the lock is removed. A process in another container may share the
    folder and the name of the machine, but its number has no meaning here. Therefore the lock file is itself locked
    (see `mbdkit.base.file_locks`) until the end of the block, which shows that the process is alive.

    Parameters
    ----------
    mutex
        An existing file, which is locked while the locks of other calls are checked.
    command
        The command named in messages.

    Raises
    ------
    ResourceError
        If another call holds the lock on a part with runs in common, or the system refuses the file.
    """
    lock = folder / f"{LOCK}{shard.number}-of-{shard.count}"
    owner = Owner.this_process()
    held = None
    try:
        with alone(mutex, is_needed=False):
            for path in sorted(folder.glob(f"{LOCK}*")):
                name = _NAME.fullmatch(path.name)
                if name is None:  # a temporary file of a call that was killed while it created its lock
                    path.unlink(missing_ok=True)
                elif shard.overlaps(Shard(int(name[1]), int(name[2]))):
                    _remove_stale(path, command)
            held = _write(lock, owner)
        yield
    finally:
        if Owner.of(lock) == owner:
            # Windows refuses this while another program has the file open; a later call then removes it.
            with contextlib.suppress(PermissionError):
                lock.unlink(missing_ok=True)
        if held is not None:
            held.close()


def _write(lock: Path, owner: Owner) -> IO[str]:
    """Create a lock file and return it, open and, where the file system supports this, locked."""
    begun, file = lock.with_name(f"{LOCK}{owner.token}"), None
    try:
        file = os.fdopen(file_locks.open_file(begun, os.O_RDWR | os.O_CREAT | os.O_EXCL), "w", encoding="utf-8")
        with contextlib.suppress(OSError):
            file_locks.lock(file.fileno())
        file.write(json.dumps(asdict(owner)))
        file.flush()
        rename_new(begun, lock)
    except OSError as error:
        if file is not None:
            file.close()
        raise ResourceError(f"the lock cannot be written: {error.strerror or error}", file=lock) from error
    finally:
        begun.unlink(missing_ok=True)
    return file


def _remove_stale(lock: Path, command: str) -> None:
    """Remove a lock whose owner is dead; raise ResourceError if the owner may be alive."""
    owner = Owner.of(lock)
    folder = lock.parent
    if owner is None and not lock.exists():
        return
    if owner is None:
        message = f"another `mbdkit {command}` may be running in this folder; if none is, remove {shown(lock)}"
        raise ResourceError(message, file=folder)
    if owner.is_dead and not file_locks.is_locked(lock):  # the lock of a process in any container
        lock.unlink(missing_ok=True)
        return
    who = f"process {owner.pid} on {shown(owner.host)}, since {shown(owner.since)}"
    if owner.is_here:
        message = f"another `mbdkit {command}` is running in this folder ({who}); wait until it ends"
    else:
        message = (
            f"another `mbdkit {command}` is running in this folder, or was killed ({who}); wait until it ends, or "
            f"remove {shown(lock)} if it no longer runs"
        )
    raise ResourceError(message, file=folder)


@contextlib.contextmanager
def alone(path: Path, *, is_needed: bool = True) -> Iterator[None]:
    """Hold an exclusive lock on a file, after waiting until other processes release it.

    If the file system does not support locks, ResourceError is raised if the lock `is_needed`; otherwise, the block
    runs without it.
    """
    try:
        handle = file_locks.open_file(path, os.O_RDWR)  # which exclusive locks need on network file systems
    except OSError:
        handle = file_locks.open_file(path, os.O_RDONLY)
    try:
        try:
            file_locks.lock(handle, wait=True)
        except OSError as error:
            if is_needed:
                raise ResourceError(f"it cannot be locked: {error.strerror or error}", file=path) from error
        yield
    finally:
        os.close(handle)
