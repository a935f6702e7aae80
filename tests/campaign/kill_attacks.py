"""Runs, studies and workers that are killed at random moments, and parts of a study that begin at the same time.

The commands run in forks of this process, which has imported everything already, and flush their archives fifty times a
second, so that many kills fall into a flush. The workers of studies are forks as well: a new interpreter imports
everything for a second, and then computes a block within milliseconds.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np

import mbdkit
import mbdkit.archive.writer
import mbdkit.runs.run_checkpoint
import mbdkit_studies.compute.pool
import mbdkit_studies.compute.unfinished_block
from mbdkit.archive.archive_check import check
from mbdkit.archive.layout import every_array, is_timing
from mbdkit.archive.part_file import checkpoint_path
from mbdkit.archive.run import Run
from mbdkit.base.errors import MbdkitError
from mbdkit.cli import main
from mbdkit_studies.compute.compute_block import compute_block
from mbdkit_studies.store.blocks import Block
from tests.forked_worker import ForkedWorker

from .archive_attacks import command_in_child
from .attack import Attack, wait_for

FLUSH = 0.02
"""Time between two flushes [s]."""

CHECKPOINT = 0.03
"""Least time between two checkpoints [s]."""

PATIENCE = 60.0
"""Time for a command to end that is not killed; other processes may need the cores [s]."""

RUN = {
    "mbdkit": 1,
    "model": {"name": "n-pendulum", "n": 3},
    "integrator": {"name": "rk4"},
    "time": {"steps": 200_000, "step": 1e-5},
    "output": {"every": 20},
}
"""A run of less than a second with 10,000 rows."""

STUDY = {
    "mbdkit_study": 1,
    "base": {**RUN, "time": {"steps": 60_000, "step": 1e-5}},
    "axes": [{"integrator": [{"name": "rk4"}, {"name": "rk-gill"}]}, {"model.length": [1.0, 2.0]}],
}
"""Four runs of some tenths of a second."""

BLOCKS = {
    "mbdkit_study": 1,
    "base": {**RUN, "model": {"name": "n-pendulum", "n": 2}, "time": {"steps": 5000, "step": 1e-4}},
    "store": "histories",
    "block": 4,
    "axes": [
        {"integrator": [{"name": "rk4"}, {"name": "gauss", "stages": 2}]},
        {"model.length": {"linspace": [1.0, 2.0, 22]}},
    ],
}
"""44 runs in 11 blocks, those of one method in lanes."""

STUDY_COMMAND = ("study", "spec.json", "--workers", "2", "--quiet")
"""The command that computes a study with two workers."""

_PENDULUM = {"mbdkit": 1, "model": {"name": "n-pendulum", "n": 3}}

_ADAPTIVE = {"adaptive": True, "rtol": 1e-11, "atol": 1e-11}

_WINDOWS = {"name": "n-four-bar", "n": 2, "speed": 1.0}

RESUMED: tuple[dict[str, Any], ...] = (
    RUN,
    {**RUN, "model": _WINDOWS, "time": {"end": 4.0, "step": 0.0002}, "output": {"every": 2}},
    {**_PENDULUM, "integrator": {"name": "gauss", "stages": 2}, "time": {"end": 10.0, "step": 0.001}},
    {
        **_PENDULUM,
        "integrator": {"name": "gauss", "stages": 2},
        "time": {"end": 1.5, "step": 0.002},
        "stabilization": "projection",
        "events": {"up": {"when": "rod2.y"}, "pull": {"when": "J1.force - 30"}},
    },
    {**_PENDULUM, "integrator": {"name": "dopri5", **_ADAPTIVE}, "time": {"end": 40.0}, "output": {"interval": 0.01}},
    {**_PENDULUM, "integrator": {"name": "radau-iia", **_ADAPTIVE}, "time": {"end": 15.0}},
    {
        **_PENDULUM,
        "integrator": {"name": "radau-iia"},
        "formulation": "index-3",
        "time": {"end": 4.0, "step": 0.001},
    },
    {**_PENDULUM, "integrator": {"name": "rattle"}, "formulation": "index-3", "time": {"end": 2.0, "step": 0.0001}},
)
"""Runs of about a second: explicit and implicit, through singular positions, with events, projections, step control."""


def start_forking(folder: Path, *arguments: str) -> int:
    """Start a command as `start_command` does, whose workers are forks."""

    def forked_workers() -> None:
        mbdkit_studies.compute.pool.subprocess = SimpleNamespace(Popen=ForkedWorker, PIPE=None)  # type: ignore[assignment]

    return start_command(folder, *arguments, prepare=forked_workers)


def start_command(folder: Path, *arguments: str, prepare: Callable[[], None] = lambda: None) -> int:
    """Start a command in a fork, after `prepare()`, and return the id of its process; the file `flushed` tells of its
    first flush.
    """
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        os.chdir(folder)
        with open(".said", "wb") as said:
            os.dup2(said.fileno(), 1)
            os.dup2(said.fileno(), 2)
        prepare()
        mbdkit.archive.writer.FLUSH_INTERVAL = FLUSH
        write_more = mbdkit.archive.writer.ArchiveWriter._write_more

        def noted(writer: Any) -> None:
            write_more(writer)
            Path("flushed").touch()

        mbdkit.archive.writer.ArchiveWriter._write_more = noted  # type: ignore[method-assign]
        mbdkit.runs.run_checkpoint.INTERVAL, mbdkit.runs.run_checkpoint.SHARE = CHECKPOINT, 1.0
        mbdkit_studies.compute.unfinished_block.INTERVAL, mbdkit_studies.compute.unfinished_block.LARGEST_RATE = (
            0.0,
            np.inf,
        )
        keep_checkpoint = mbdkit.archive.writer.ArchiveWriter.keep_checkpoint

        def kept(writer: Any, state: Any) -> None:
            keep_checkpoint(writer, state)
            Path("checkpoint").touch()

        mbdkit.archive.writer.ArchiveWriter.keep_checkpoint = kept  # type: ignore[method-assign]
        sys.argv = ["mbdkit", *arguments]
        main()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    finally:
        os._exit(status)


def said(folder: Path) -> str:
    with contextlib.suppress(OSError):
        return (folder / ".said").read_text(errors="replace")[-300:]
    return ""


def finish(folder: Path, *arguments: str, start: Callable[..., int] = start_command) -> list[str]:
    """Run a command to its end, which must be a success."""
    status, *_ = wait_for(start(folder, *arguments), time.monotonic() + PATIENCE)
    return [] if status == 0 else [f"`mbdkit {' '.join(arguments)}` ended with {status}: {said(folder)}"]


def _write_spec(folder: Path, spec: dict[str, Any]) -> None:
    (folder / "spec.json").write_text(json.dumps(spec))


@cache
def _whole_run() -> tuple[Run, float]:
    """Return the run that nobody disturbs, in memory, and the time that it takes [s]."""
    start = time.monotonic()
    run = mbdkit.run(RUN)
    return run, time.monotonic() - start


@cache
def _whole(spec: str) -> tuple[str, float]:
    """Return the hash of a run that nobody disturbs, and the time that it takes [s]."""
    mbdkit.run(json.loads(spec)).close()  # compiles
    start = time.monotonic()
    with mbdkit.run(json.loads(spec)) as run:
        return run.data_sha256, time.monotonic() - start


@cache
def _whole_study() -> tuple[dict[str, str], float]:
    """Return the hashes of the study that nobody disturbs by run id, and the time that it takes [s]."""
    with tempfile.TemporaryDirectory(prefix="campaign-") as folder:
        study = mbdkit.study(STUDY, out=Path(folder) / "out", workers=2)
        _write_spec(Path(folder), STUDY)
        start = time.monotonic()
        assert not (found := finish(Path(folder), *STUDY_COMMAND, "-o", "forked", start=start_forking)), found
        return {point.run_id: point.data_sha256 for point in study.points}, time.monotonic() - start


def _index_hash(folder: Path) -> str:
    """Return the hash of the index of a study without its times."""
    with h5py.File(folder / "index.h5") as file:
        return str(file.attrs["data_sha256"])


@cache
def _whole_blocks() -> tuple[str, float]:
    """Return the hash of the index of the study in blocks that nobody disturbs, and the time that it takes [s]."""
    with tempfile.TemporaryDirectory(prefix="campaign-") as name:
        folder = Path(name)
        mbdkit.study(BLOCKS, out=folder / "out", workers=2)
        for block in (0, 10):  # load in this process what its forks need
            compute_block(folder / "out", block)
        _write_spec(folder, BLOCKS)
        start = time.monotonic()
        found = finish(folder, *STUDY_COMMAND, "-o", "forked", start=start_forking)
        taken = time.monotonic() - start
        hashes = {_index_hash(folder / one) for one in ("out", "forked")}
        assert not found, found
        assert len(hashes) == 1
        return hashes.pop(), taken


def _rows_problems(run: Run, least: int, last_is_free: bool = False) -> list[str]:
    """Compare the rows of a run with those of the undisturbed one; its last row may be one of an early end."""
    whole, _ = _whole_run()
    rows = len(run.time)
    found = [] if rows >= least else [f"it has {rows} rows, not at least {least}"]
    for array in every_array():
        if not array.grows or not run.records(array.path):
            continue
        values, expected = run.array(array.path), whole.array(array.path)
        count = rows if array.dims[0] == "time" else max(rows - 1, 0)
        if len(values) != count:
            found.append(f"{array.path} has {len(values)} rows, not {count}")
        elif not is_timing(array.path):
            same = count - last_is_free
            if not np.array_equal(values[: max(same, 0)], expected[: max(same, 0)], equal_nan=True):
                found.append(f"{array.path} differs from the undisturbed run")
    return found


def _left(folder: Path) -> list[str]:
    return sorted(set(os.listdir(folder)) - {"spec.json", "flushed", "checkpoint", ".said"})


def kill_run(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill a run, and run it again."""
    _write_spec(folder, RUN)
    whole, seconds = _whole_run()
    child = start_command(folder, "run", "spec.json", "-o", "run.h5", "--quiet")
    time.sleep(random.uniform(0, 1.3 * seconds))
    os.kill(child, signal.SIGKILL)
    wait_for(child, time.monotonic() + PATIENCE)
    found = []
    left = _left(folder)
    archives = [name for name in left if not name.startswith("run.h5.part.checkpoint")]
    if archives not in ([], ["run.h5"], ["run.h5.part"], ["run.h5", "run.h5.part"]):
        found.append(f"the killed run left {', '.join(left)}")
    if "run.h5" in left:
        found += check(folder / "run.h5")
    elif left:
        try:
            with mbdkit.load(folder / "run.h5.part") as run:
                found += _rows_problems(run, least=(folder / "flushed").exists())
        except MbdkitError as error:
            if (folder / "flushed").exists():
                found.append(f"the .part cannot be read: {error}")
    found += finish(folder, "run", "spec.json", "-o", "run.h5", "--quiet", "--overwrite")
    if not found:
        if _left(folder) != ["run.h5"]:
            found.append(f"the second run left {', '.join(_left(folder))}")
        with mbdkit.load(folder / "run.h5") as run:
            if run.data_sha256 != whole.data_sha256:
                found.append("the second run differs from the undisturbed one")
    return found


def resume(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill a run up to three times, resume it each time, and compare its bits with those of the undisturbed run."""
    spec = RESUMED[int(random.integers(len(RESUMED)))]
    whole, seconds = _whole(json.dumps(spec))
    _write_spec(folder, spec)
    arguments = ["run", "spec.json", "-o", "run.h5", "--quiet"]
    for _ in range(int(random.integers(1, 4))):
        child = start_command(folder, *arguments)
        time.sleep(random.uniform(0, seconds))
        os.kill(child, signal.SIGKILL)
        status, *_ = wait_for(child, time.monotonic() + PATIENCE)
        if status not in (-signal.SIGKILL, 0):
            return [f"`mbdkit {' '.join(arguments)}` ended with {status}: {said(folder)}"]
        if (folder / "run.h5").exists():
            break
        if (folder / "run.h5.part").exists():
            arguments = ["run", "--resume", "run.h5.part", "--quiet"]
            if not (folder / "checkpoint").exists():  # the run had none yet, and says so
                status, *_ = wait_for(start_command(folder, *arguments), time.monotonic() + PATIENCE)
                if status == 0:
                    break
                told = said(folder)
                if status != 2 or "Traceback" in told:
                    return [f"a run without checkpoint was resumed with exit status {status}: {told}"]
                arguments = ["run", "spec.json", "-o", "run.h5", "--quiet"]
    if not (folder / "run.h5").exists() and (found := finish(folder, *arguments)):
        return found
    left = set(_left(folder))
    if {name for name in left if not name.startswith("run.h5.resumed.part")} != {"run.h5"}:
        return [f"it left {', '.join(sorted(left))}"]
    found = check(folder / "run.h5")
    with mbdkit.load(folder / "run.h5") as run:
        if run.data_sha256 != whole:
            found.append("the resumed run differs from the undisturbed one")
    return found


@cache
def _killed() -> dict[str, bytes]:
    """Return the ``.part`` and the checkpoint of a killed run, by name."""
    _, seconds = _whole_run()
    while True:
        with tempfile.TemporaryDirectory(prefix="campaign-") as name:
            folder = Path(name)
            _write_spec(folder, RUN)
            child = start_command(folder, "run", "spec.json", "-o", "run.h5", "--quiet")
            until = time.monotonic() + PATIENCE
            while not (folder / "checkpoint").exists() and time.monotonic() < until:
                time.sleep(0.001)
            time.sleep(0.2 * seconds)
            os.kill(child, signal.SIGKILL)
            wait_for(child, time.monotonic() + PATIENCE)
            files = {name: folder / name for name in ("run.h5.part", "run.h5.part.checkpoint")}
            if all(path.exists() for path in files.values()):
                return {name: path.read_bytes() for name, path in files.items()}


def damaged_checkpoint(random: np.random.Generator, folder: Path) -> list[str]:
    """Flip some bits of a killed run or of its checkpoint, and resume it: the same bits, or a refusal."""
    whole, _ = _whole_run()
    contents = {name: bytearray(content) for name, content in _killed().items()}
    name = "run.h5.part.checkpoint" if random.random() < 0.8 else "run.h5.part"
    for _ in range(int(random.integers(1, 4))):
        bit = int(random.integers(8 * len(contents[name])))
        contents[name][bit // 8] ^= 1 << bit % 8
    for one, content in contents.items():
        (folder / one).write_bytes(content)
    ending = command_in_child("run", "--resume", "run.h5.part", "--quiet", folder=folder, seconds=PATIENCE)
    found = [
        text
        for text in ending.problems(allowed=(0, 2, 3), what=f"flipped bits of {name}")
        if " took " not in text or "MiB" in text
    ]
    if ending.exit_status == 0:
        found += check(folder / "run.h5")
        with mbdkit.load(folder / "run.h5") as run:
            if run.data_sha256 != whole.data_sha256:
                found.append(f"with flipped bits of {name} the resumed run differs from the undisturbed one")
    elif (folder / name).read_bytes() != contents[name]:
        found.append(f"{name} was refused and changed")
    return found


def stop_run(random: np.random.Generator, folder: Path) -> list[str]:
    """Stop a run by SIGTERM, in half of the cases sent twice as `timeout` does, and resume it."""
    _write_spec(folder, RUN)
    whole, seconds = _whole_run()
    child = start_command(folder, "run", "spec.json", "-o", "run.h5", "--quiet")
    time.sleep(random.uniform(0, 1.3 * seconds))
    sent = time.monotonic()
    os.kill(child, signal.SIGTERM)
    if random.random() < 0.5:
        os.kill(child, signal.SIGTERM)
    status, *_ = wait_for(child, time.monotonic() + PATIENCE)
    left = _left(folder)
    found = []
    if left == [] and status in (130, -signal.SIGTERM):
        return []  # it had not begun
    if status not in (0, 130):
        found.append(f"it ended with exit status {status}, {time.monotonic() - sent:.1f} s later: {said(folder)}")
    is_resumable = "run.h5.checkpoint" in left
    if left != ["run.h5", "run.h5.checkpoint"][: 1 + is_resumable]:
        return [*found, f"it left {', '.join(left) or 'nothing'}"]
    found += check(folder / "run.h5")
    with mbdkit.load(folder / "run.h5") as run:
        if run.status not in (("complete",) if status == 0 else ("interrupted", "complete")):
            found.append(f"exit status {status}, but the status of the run is {run.status}")
        found += _rows_problems(run, least=1, last_is_free=True)
    if is_resumable:
        found += finish(folder, "run", "--resume", "run.h5", "--overwrite", "--quiet")
        with mbdkit.load(folder / "run.h5") as run:
            if run.data_sha256 != whole.data_sha256 or _left(folder) != ["run.h5"]:
                found.append("the resumed run differs from the undisturbed one")
    return found


def _study_problems(folder: Path) -> list[str]:
    """Return what is wrong with the archives of a study that was disturbed."""
    hashes, _ = _whole_study()
    found = []
    for path in sorted((folder / "out" / "runs").glob("*.h5")):
        found += [f"{path.name}: {problem}" for problem in check(path)]
        with mbdkit.load(path) as run:
            if run.status == "complete" and run.data_sha256 != hashes[path.stem]:
                found.append(f"{path.name} differs from the undisturbed study")
    return found


def _repeated_problems(folder: Path) -> list[str]:
    """Repeat a study that was disturbed, and compare it with the undisturbed one."""
    hashes, _ = _whole_study()
    found = finish(folder, *STUDY_COMMAND, "-o", "out", start=start_forking)
    if found:
        return found
    study = mbdkit.load_study(folder / "out")
    if {point.run_id: point.data_sha256 for point in study.points} != hashes:
        found.append("the repeated study differs from the undisturbed one")
    left = sorted(os.listdir(folder / "out")), sorted(os.listdir(folder / "out" / "runs"))
    if left != (["index.h5", "runs", "study.yaml"], sorted(f"{run_id}.h5" for run_id in hashes)):
        found.append(f"the repeated study left {left}")
    return found


def _study_begun(random: np.random.Generator, folder: Path) -> int:
    """Start a study with two workers, wait for a random part of the time that it takes, and return its process."""
    _write_spec(folder, STUDY)
    _, seconds = _whole_study()
    child = start_forking(folder, *STUDY_COMMAND, "-o", "out")
    time.sleep(random.uniform(0, seconds))
    return child


def kill_study(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill a study, and repeat it."""
    child = _study_begun(random, folder)
    os.kill(child, signal.SIGKILL)
    wait_for(child, time.monotonic() + PATIENCE)
    _wait_for_workers(folder / "out" / "runs")
    return _study_problems(folder) + _repeated_problems(folder)


def kill_blocks(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill a study in blocks up to three times, and complete it: blocks that are there stay, and the index is the same.

    In a third of the cases a worker is killed first, which costs nothing.
    """
    _write_spec(folder, BLOCKS)
    whole, seconds = _whole_blocks()
    runs = folder / "out" / "runs"
    arguments = [*STUDY_COMMAND, "-o", "out"]
    found: list[str] = []
    kept: dict[str, int] = {}
    for _ in range(int(random.integers(1, 4))):
        child = start_forking(folder, *arguments)
        time.sleep(random.uniform(0, seconds))
        if random.random() < 1 / 3:
            _kill_worker(child, random)
            time.sleep(random.uniform(0, seconds / 4))
        os.kill(child, signal.SIGKILL)
        status, *_ = wait_for(child, time.monotonic() + PATIENCE)
        if status not in (-signal.SIGKILL, 0):
            found.append(f"`mbdkit {' '.join(arguments)}` ended with {status}: {said(folder)}")
        _wait_for_workers(runs)
        found += [f"{name} was computed twice" for name, when in kept.items() if _written(runs / name) != when]
        blocks = sorted(runs.glob("block-*.h5"))
        found += [f"{path.name}: {problem}" for path in blocks if path.name not in kept for problem in check(path)]
        kept = {path.name: _written(path) for path in blocks}
    if found := found or finish(folder, *arguments, start=start_forking):
        return found
    found += [f"{name} was computed twice" for name, when in kept.items() if _written(runs / name) != when]
    if _index_hash(folder / "out") != whole:
        found.append("the index differs from that of the undisturbed study")
    numbers: list[int] = []
    for path in sorted(runs.glob("block-*.h5")):
        with Block(path) as block:
            numbers += block.numbers.tolist()
    if numbers != list(range(1, 45)):
        found.append(f"the blocks have the runs {numbers}")
    left = sorted(os.listdir(folder / "out")), sorted(os.listdir(runs))
    if left != (["index.h5", "runs", "study.yaml"], [f"block-{number:06d}.h5" for number in range(11)]):
        found.append(f"the completed study left {left}")
    return found


def _written(path: Path) -> int:
    """Return when a file was written [ns]; 0 if it is gone."""
    with contextlib.suppress(OSError):
        return path.stat().st_mtime_ns
    return 0


def stop_study(random: np.random.Generator, folder: Path) -> list[str]:
    """Stop a study by SIGTERM, and repeat it."""
    child = _study_begun(random, folder)
    os.kill(child, signal.SIGTERM)
    if random.random() < 0.5:
        os.kill(child, signal.SIGTERM)
    status, *_ = wait_for(child, time.monotonic() + PATIENCE)
    found = []
    if status not in (0, 130) and (folder / "out").exists():
        found.append(f"it ended with exit status {status}: {said(folder)}")
    if any(not checkpoint_path(part).is_file() for part in (folder / "out" / "runs").glob("*.part")):
        found.append("it left an unfinished archive that no call can continue")
    there = {path.stem for path in (folder / "out" / "runs").glob("*.h5")}
    if there:
        study = mbdkit.load_study(folder / "out")
        indexed = {point.run_id for point in study.points if point.status == "complete"}
        if indexed != there:
            found.append(f"its index has {len(indexed)} of {len(there)} runs")
    return found + _study_problems(folder) + _repeated_problems(folder)


def kill_worker(random: np.random.Generator, folder: Path) -> list[str]:
    """Kill one worker of a study, by SIGKILL, SIGTERM or SIGSEGV: the same call computes its run again."""
    hashes, _ = _whole_study()
    child = _study_begun(random, folder)
    _kill_worker(child, random)
    status, *_ = wait_for(child, time.monotonic() + PATIENCE)
    if status != 0:
        return [f"it ended with exit status {status}: {said(folder)}"]
    study = mbdkit.load_study(folder / "out")
    if {point.run_id: point.data_sha256 for point in study.points} != hashes:
        return ["the study differs from the undisturbed one"]
    return []


def begin_parts(random: np.random.Generator, folder: Path) -> list[str]:
    """Begin the two parts of a study in a new folder within milliseconds."""
    _write_spec(folder, STUDY)
    hashes, _ = _whole_study()
    children = []
    for part in ("1/2", "2/2"):
        children.append(
            start_forking(folder, "study", "spec.json", "-o", "out", "--workers", "1", "--quiet", "--shard", part)
        )
        time.sleep(random.uniform(0, 0.005))
    found = []
    for part, child in enumerate(children, start=1):
        status, *_ = wait_for(child, time.monotonic() + PATIENCE)
        if status != 0:
            found.append(f"part {part} ended with exit status {status}: {said(folder)}")
    if not found:
        study = mbdkit.load_study(folder / "out")
        if {point.run_id: point.data_sha256 for point in study.points} != hashes:
            found.append("the parts differ from the undisturbed study")
    return found


def _kill_worker(child: int, random: np.random.Generator) -> None:
    with contextlib.suppress(OSError, IndexError, ValueError):
        workers = Path(f"/proc/{child}/task/{child}/children").read_text().split()
        os.kill(int(random.choice(workers)), random.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV]))


def _wait_for_workers(runs: Path) -> None:
    """Wait until the workers of a study that was killed have noticed; they may rename a file until then."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline and any(_is_locked(path) for path in runs.glob("*")):
        time.sleep(0.01)


def _is_locked(path: Path) -> bool:
    import fcntl

    try:
        with path.open("rb") as handle:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


ATTACKS = (
    Attack(
        "kill-run", "SIGKILL to a run: whole rows in the .part, no damaged archive, and it runs again", 200, kill_run
    ),
    Attack(
        "resume", "SIGKILL to a run, up to three times: resumed, it has the bits of the undisturbed one", 100, resume
    ),
    Attack(
        "checkpoints", "flipped bits of a checkpoint: refused, or resumed to the same bits", 500, damaged_checkpoint
    ),
    Attack("stop-run", "SIGTERM to a run: its archive is sound, and the run can be resumed", 200, stop_run),
    Attack(
        "kill-study", "SIGKILL to a study: the next call completes it, equal to the undisturbed one", 200, kill_study
    ),
    Attack(
        "kill-blocks", "SIGKILL to a study in blocks, up to three times: no block is lost or doubled", 100, kill_blocks
    ),
    Attack("stop-study", "SIGTERM to a study: its index is there, and the next call completes it", 200, stop_study),
    Attack("kill-worker", "a signal to a worker of a study: the same call completes it", 200, kill_worker),
    Attack("begin-parts", "two parts of a study begin at the same time", 100, begin_parts),
)
