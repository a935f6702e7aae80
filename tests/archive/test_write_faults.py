"""Faults of the system while an archive is written: afterwards there is no archive, or a sound one, and the exit status
of the command says which.
"""

from __future__ import annotations

import errno
import json
import os
import random
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mbdkit
from mbdkit.archive import writer as archive_writer
from mbdkit.archive.archive_check import check
from mbdkit.base.errors import ArchiveError
from mbdkit.cli import main
from tests.forked_process import ForkedProcess

from .making import make

PRECIOUS = b"precious"
CALLS = ("write", "fsync", "ftruncate", "link", "replace", "unlink", "close")
INTERVALS = {"as a whole": 1e9, "during the run": 0.0}
"""Times between flushes [s]: the archive is written by one call at the end, or by HDF5 during the run."""


class Faults:
    """Replaces calls of `os`, and lets one or all calls from `number` on fail if they concern the archive.

    Parameters
    ----------
    call
        Name of the function; empty for none.
    effect
        ``short`` for writes of half of the bytes; ``full`` for one such write, after which nothing can be written; or a
        number of `errno`.
    is_lasting
        Whether later calls fail too.
    """

    def __init__(self, call: str, number: int, effect: str | int, *, is_lasting: bool):
        self.call, self.number, self.effect, self.is_lasting = call, number, effect, is_lasting
        self.counts: Counter[str] = Counter()

    def install(self) -> None:
        """Replace the functions, in a process of its own."""
        for name in CALLS:
            setattr(os, name, self._replaced(name, getattr(os, name)))

    def _replaced(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(target: Any, *rest: Any, **options: Any) -> Any:
            path = os.readlink(f"/proc/self/fd/{target}") if isinstance(target, int) else str(target)
            if "run.h5" not in path:
                return function(target, *rest, **options)
            self.counts[name] += 1
            is_first = name == self.call and self.counts[name] == self.number
            is_later = self.is_lasting and name == self.call and self.counts[name] > self.number
            if (is_first and self.effect == "full") or ((is_first or is_later) and self.effect == "short"):
                return function(target, rest[0][: max(1, len(rest[0]) // 2)])
            if self.effect == "full" and name == "write" and self.counts["write"] >= self.number:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if (is_first or is_later) and isinstance(self.effect, int):
                raise OSError(self.effect, os.strerror(self.effect))
            return function(target, *rest, **options)

        return call


def run_with(folder: Path, faults: Faults, interval: float, *options: str) -> tuple[int, str]:
    """Run ``mbdkit run`` with faults, and return its exit status and what it says."""

    def command() -> None:
        archive_writer.FLUSH_INTERVAL = interval
        faults.install()
        sys.argv = ["mbdkit", "run", "pendulum", "--quiet", "-o", "run.h5", "--set", "time.end=0.2", *options]
        try:
            main()
        finally:
            print("calls", json.dumps(faults.counts))

    process = ForkedProcess(command, folder)
    try:
        said = "".join(process.communicate(120.0))
        assert process.returncode is not None
        return process.returncode, said
    finally:
        process.kill()


def assert_status_is_true(folder: Path, status: int, said: str, before: bytes | None) -> bool:
    """Check that the archive is sound if the status is 0, and otherwise that there is none or the former file."""
    archive = folder / "run.h5"
    assert "Traceback" not in said
    if status == 0:
        assert check(archive) == [], said
        return True
    assert status == 3, said
    assert said.count("run.h5") > 0
    assert (archive.read_bytes() if archive.exists() else None) == before, said
    part = folder / "run.h5.part"
    if part.exists() and part.stat().st_size and "cannot be renamed" in said:
        assert check(part) == []
    return False


def counted_calls(folder: Path, interval: float, *options: str) -> dict[str, int]:
    """Return the number of calls of each function in a run without faults."""
    folder.mkdir()
    status, said = run_with(folder, Faults("", 0, "", is_lasting=False), interval, *options)
    assert status == 0, said
    line = next(line for line in said.splitlines() if line.startswith("calls "))
    return {name: int(count) for name, count in json.loads(line.removeprefix("calls ")).items()}


def check_drawn_faults(folder: Path, number: int) -> Counter[bool]:
    """Run with `number` drawn faults; return how many runs have left an archive (True) and none (False)."""
    mbdkit.run("pendulum", time={"end": 0.1, "step": 0.01}, archive=folder / "first.h5")  # forks have what this imports
    draw, ends = random.Random(11), Counter[bool]()
    known: dict[tuple[str, bool], dict[str, int]] = {}
    for case in range(number):
        moment, is_replaced = draw.choice(list(INTERVALS)), draw.random() < 0.5
        options = ["--overwrite"] if is_replaced else []
        if (moment, is_replaced) not in known:
            known[moment, is_replaced] = counted_calls(folder / f"{moment} {is_replaced}", INTERVALS[moment], *options)
        counts = known[moment, is_replaced]
        call = "write" if draw.random() < 0.6 else draw.choice(sorted(counts))
        effect = draw.choice(
            ["short", "full", errno.ENOSPC, errno.EIO] if call == "write" else [errno.ENOSPC, errno.EIO]
        )
        faults = Faults(call, draw.randint(1, counts[call]), effect, is_lasting=draw.random() < 0.5)
        place = folder / str(case)
        place.mkdir()
        if is_replaced:
            (place / "run.h5").write_bytes(PRECIOUS)
        status, said = run_with(place, faults, INTERVALS[moment], *options)
        try:
            ends[assert_status_is_true(place, status, said, PRECIOUS if is_replaced else None)] += 1
        except (AssertionError, ArchiveError) as error:
            error.add_note(f"{moment}: {vars(faults)}, status {status}, {os.listdir(place)}: {said}")
            raise
    return ends


@pytest.mark.parametrize("interval", INTERVALS.values(), ids=list(INTERVALS))
def test_nothing_is_written_after_the_archive_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, interval: float
) -> None:
    renamed, link = [], os.link

    def noted(source: Path, target: Path) -> None:
        renamed.append(Path(source).read_bytes())
        link(source, target)

    monkeypatch.setattr(archive_writer, "FLUSH_INTERVAL", interval)
    monkeypatch.setattr(archive_writer.time, "perf_counter", lambda: 0.0)  # a clock that stands still
    monkeypatch.setattr(os, "link", noted)
    make(tmp_path / "run.h5")
    assert renamed == [(tmp_path / "run.h5").read_bytes()]
    assert check(tmp_path / "run.h5") == []


def test_archives_are_sound_or_absent_after_drawn_faults(tmp_path: Path) -> None:
    ends = check_drawn_faults(tmp_path, 8)
    assert min(ends[True], ends[False]) > 1


@pytest.mark.slow
def test_archives_are_sound_or_absent_after_many_drawn_faults(tmp_path: Path) -> None:
    ends = check_drawn_faults(tmp_path, 400)
    assert min(ends[True], ends[False]) > 50
