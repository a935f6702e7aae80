"""Folders of studies and designs with damaged or exchanged files, without permission, and used by two calls at once."""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from tests.studies.pool_in_this_process import PoolInThisProcess

import mbdkit
from mbdkit.archive.archive_check import check
from mbdkit_studies.compute import executor_pool

from .archive_attacks import command_in_child, small_archive
from .attack import LONGEST_MESSAGE, Attack, Ending, in_child
from .kill_attacks import PATIENCE
from .specs import pendulum

DESIGN: dict[str, Any] = {
    "mbdkit_design": 1,
    "base": pendulum(),
    "variables": {"model.length": {"bounds": [0.5, 2.0], "start": 1.0}},
    "minimize": "(final(rod1.y) + 0.3)**2",
    "optimizer": {"name": "slsqp"},
}

STUDY: dict[str, Any] = {
    "mbdkit_study": 1,
    "base": pendulum(),
    "axes": [{"integrator": [{"name": "rk4"}, {"name": "rk-gill"}]}],
    "reference": {"integrator": {"name": "gauss", "stages": 3}},
}

BLOCKS: dict[str, Any] = {
    **STUDY,
    "store": "histories",
    "block": 2,
    "axes": [{"model.length": {"linspace": [1.0, 2.0, 6]}}],
    "reference": "none",
}

INVERSE: dict[str, Any] = {
    "mbdkit": 1,
    "model": pendulum()["model"],
    "motion": {"file": "motion.csv", "columns": {"J1.angle": "angle"}, "smooth": "spline"},
}

MOTION = "time,angle\n" + "".join(f"{0.01 * i:.2f},{0.3 * np.sin(0.05 * i):.6f}\n" for i in range(40))


def work_here() -> None:
    """Let studies and designs be computed without worker processes, which need seconds to begin."""
    executor_pool.Pool = PoolInThisProcess  # type: ignore[assignment, misc]


def write_specs(folder: Path) -> None:
    """Write the specs, the table and the archive that `COMMANDS` read."""
    for name, spec in {
        "run": pendulum(),
        "study": STUDY,
        "blocks": BLOCKS,
        "design": DESIGN,
        "inverse": INVERSE,
    }.items():
        (folder / f"{name}.json").write_text(json.dumps(spec))
    (folder / "motion.csv").write_text(MOTION)
    (folder / "run.h5").write_bytes(small_archive())


COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", "run.json", "-o", "OUT/out.h5"),
    "inverse": ("inverse", "inverse.json", "-o", "OUT/out.h5"),
    "study": ("study", "study.json", "-o", "OUT/out", "--workers", "1"),
    "blocks": ("study", "blocks.json", "-o", "OUT/out", "--workers", "1"),
    "design": ("design", "design.json", "-o", "OUT/out"),
    "report": ("report", "run.h5", "-o", "OUT/out.html"),
    "report.md": ("report", "run.h5", "-o", "OUT/out.md"),
    "plot": ("plot", "run.h5", "-o", "OUT/out.svg"),
    "animate": ("animate", "run.h5", "-o", "OUT/out.html"),
    "export": ("archive", "export", "run.h5", "--to", "csv", "-o", "OUT/out"),
    "equilibrium": ("equilibrium", "run.json", "--write", "OUT/out.yaml"),
    "rerun": ("rerun", "run.h5", "-o", "OUT/out.h5"),
}
"""The commands that write something into a folder OUT."""


@cache
def whole() -> Path:
    """Return a folder with a complete study, study in blocks, ensemble and design, made once for all cases."""
    folder = Path(tempfile.mkdtemp(prefix="campaign-whole-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    write_specs(folder)
    mbdkit.study(STUDY, out=folder / "study")
    mbdkit.study(BLOCKS, out=folder / "blocks")
    mbdkit.ensemble(pendulum(), {"model.length": np.linspace(1.0, 2.0, 4)}, store="all", out=folder / "members")
    mbdkit.design(DESIGN, out=folder / "design")
    for module in (
        "mbdkit_report.pages.report",
        "mbdkit_studies.report.study_report",
        "mbdkit_design.design_report",
        "mbdkit_report.export",
        "mbdkit_statics.commands",
    ):
        importlib.import_module(module)  # forks have them, then
    return folder


READERS: dict[str, list[tuple[str, ...]]] = {
    "study": [("study", "study/study.yaml", "-o", "study", "--workers", "1"), ("report", "study", "--overwrite")],
    "blocks": [("study", "blocks/study.yaml", "-o", "blocks", "--workers", "1"), ("report", "blocks", "--overwrite")],
    "members": [
        ("study", "members/study.yaml", "-o", "members", "--workers", "1"),
        ("report", "members", "--overwrite"),
    ],
    "design": [("design", "design/design.yaml", "-o", "design"), ("report", "design", "--overwrite")],
}
"""The commands that read a folder."""


def _flip(random: np.random.Generator, path: Path) -> None:
    content = bytearray(path.read_bytes())
    bit = int(random.integers(8 * len(content)))
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def _truncate(random: np.random.Generator, path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(random.integers(len(content)))])


def _pipe(random: np.random.Generator, path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _link(random: np.random.Generator, path: Path) -> None:
    path.unlink()
    path.symlink_to("/etc/passwd")


def _folder(random: np.random.Generator, path: Path) -> None:
    path.unlink()
    path.mkdir()


def _sparse(random: np.random.Generator, path: Path) -> None:
    with path.open("r+b") as file:
        file.truncate(1 << 40)


def _write(content: bytes, random: np.random.Generator, path: Path) -> None:
    path.write_bytes(content)


def _append(content: bytes, random: np.random.Generator, path: Path) -> None:
    with path.open("ab") as file:
        file.write(content)


def _other(random: np.random.Generator, path: Path) -> None:
    files = sorted(one for one in whole().rglob("*") if one.is_file() and one.suffix == path.suffix)
    path.write_bytes(files[int(random.integers(len(files)))].read_bytes())


DAMAGES: dict[str, Callable[[np.random.Generator, Path], None]] = {
    "a flipped bit": _flip,
    "the end left out": _truncate,
    "another file of the same kind": _other,
    "a pipe": _pipe,
    "a link": _link,
    "a folder": _folder,
    "a sparse file": _sparse,
    "nothing": partial(_write, b""),
    "zeros": partial(_write, bytes(1 << 20)),
    "deep JSON": partial(_write, b"[" * 1_000_000),
    "deep JSON at the end": partial(_append, b"[" * 1_000_000 + b"\n"),
    "a long line": partial(_append, b'{"a": "' + b"x" * 20_000_000 + b'"}\n'),
    "a large number": partial(_append, b'{"values": {"goal": ' + b"9" * 400 + b"}}\n"),
    "not a number": partial(_append, b'{"scenario": "", "settings": {}, "values": {"goal": NaN}, "crc32": 0}\n'),
    "a later version": partial(_write, b'{"mbdkit_points": 9, "mbdkit_design": 9}\n'),
}


def damage(random: np.random.Generator, folder: Path) -> list[str]:
    """Damage a file of a study or a design, and use the folder."""
    name = list(READERS)[int(random.integers(len(READERS)))]
    shutil.copytree(whole() / name, folder / name)
    files = sorted(path for path in (folder / name).rglob("*") if path.is_file())
    path, (what, change) = files[int(random.integers(len(files)))], list(DAMAGES.items())[random.integers(len(DAMAGES))]
    change(random, path)
    found = []
    for words in READERS[name]:
        ending = command_in_child(*words, folder=folder, seconds=5 * PATIENCE, prepare=work_here)
        told = f"`mbdkit {' '.join(words)}` with {what} in {path.relative_to(folder)}"
        found += _problems(ending, told, allowed=(0, 2, 3))
        if (
            ending.exit_status == 0
            and words[0] in ("study", "design")
            and _results(folder / name) != _wanted(folder, name)
        ):
            found.append(f"{told} returned other results")
    return found


def _wanted(folder: Path, name: str) -> Any:
    """Return the results of a study or design, of that whose spec has taken the place of its own."""
    spec = Path(READERS[name][0][1]).name
    others = (other for other in READERS if (whole() / other / spec).exists())
    same = (other for other in others if (whole() / other / spec).read_bytes() == (folder / name / spec).read_bytes())
    return _results(whole() / next(same, name))


def _results(folder: Path) -> Any:
    """Return what a study or a design has found."""
    if (folder / "design.json").exists():
        return json.loads((folder / "design.json").read_text())["best"]
    study = mbdkit.load_study(folder)
    return [(point.status, point.data_sha256) for point in study.points]


def _problems(ending: Ending, told: str, allowed: tuple[int, ...]) -> list[str]:
    """Return what did not hold in the end of a command, whatever time the work took."""
    found = [text for text in ending.problems(what=told, allowed=allowed) if " took " not in text or "MiB" in text]
    if ending.exit_status and not (ending.errors + ending.output).strip():
        found.append(f"{told} ended with {ending.exit_status} without a word")
    if len(ending.errors) > LONGEST_MESSAGE:
        found.append(f"{told} said {len(ending.errors)} characters")
    return found


def _as_nobody() -> None:
    """Become a user without rights, if this is the administrator, for whom permissions do not count."""
    work_here()
    if os.geteuid() == 0:
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)


def forbidden(random: np.random.Generator, folder: Path) -> list[str]:
    """Write into a folder that belongs to somebody else, is read-only, or has files of somebody else."""
    whole()
    name = list(COMMANDS)[int(random.integers(len(COMMANDS)))]
    words = [word.replace("OUT", "place") for word in COMMANDS[name]]
    write_specs(folder)
    (folder / "place").mkdir()
    folder.chmod(0o755)
    how = ["a folder of somebody else", "a file of somebody else", "a folder that cannot be read"][random.integers(3)]
    target = folder / "place" / Path(next(word for word in words if word.startswith("place/"))).name
    is_nobody = os.geteuid() == 0
    if how == "a file of somebody else" and target.suffix:
        target.write_text("precious")
        target.chmod(0o644)
        (folder / "place").chmod(0o1777)  # as /tmp: others may create files, and not replace this one
        words += ["--overwrite"]
    elif how == "a folder that cannot be read":
        (folder / "place").chmod(0o000 if not is_nobody else 0o700)
    else:
        (folder / "place").chmod(0o555)
    ending = command_in_child(*words, folder=folder, seconds=5 * PATIENCE, prepare=_as_nobody)
    (folder / "place").chmod(0o755)
    found = _problems(ending, f"{name} into {how}", allowed=(2, 3))
    # an archive that cannot take the place of a file keeps the name of an unfinished one, and the message says so
    kept = f"{target.name}.part" if "cannot be renamed" in ending.errors else ""
    left = [path.name for path in (folder / "place").iterdir() if path.name not in (target.name, kept)]
    found += [f"{name} into {how} left {', '.join(left)}"] if left else []
    if target.is_file() and target.read_text(errors="replace") != "precious":
        found.append(f"{name} into {how} changed {target.name}")
    return found


def pair(random: np.random.Generator, folder: Path) -> list[str]:
    """Let two calls write the same file or folder, begun within milliseconds."""
    whole()
    name = list(COMMANDS)[int(random.integers(len(COMMANDS)))]
    write_specs(folder)
    (folder / "place").mkdir()
    words = [word.replace("OUT", "place") for word in COMMANDS[name]]
    if random.random() < 0.5 and name not in ("study", "blocks", "design", "plot", "animate"):
        words.append("--overwrite")
    wait = float(random.uniform(0, 0.3) * (random.random() < 0.7))

    def second() -> Ending:
        time.sleep(wait)
        return command_in_child(*words, folder=folder, seconds=5 * PATIENCE, prepare=work_here)

    def both() -> tuple[Ending, Ending]:
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(2) as threads:  # each waits for a process
            one = threads.submit(command_in_child, *words, folder=folder, seconds=5 * PATIENCE, prepare=work_here)
            two = threads.submit(second)
            return one.result(), two.result()

    endings = in_child(both, seconds=3 * PATIENCE)
    if endings.value is None:
        return [f"two calls of {name} did not end: {endings.errors[-300:]}"]
    found = [
        problem
        for ending in endings.value
        for problem in _problems(ending, f"one of two calls of {name}", allowed=(0, 2, 3))
    ]
    if all(ending.exit_status for ending in endings.value):
        told = [(ending.exit_status, (ending.output + ending.errors)[-300:]) for ending in endings.value]
        found.append(f"both calls of {name} failed: {told}")
    left = sorted(path.name for path in (folder / "place").iterdir())
    if any(one.startswith(".") or "part" in one for one in left):
        found.append(f"two calls of {name} left {', '.join(left)}")
    return found + unsound(folder / "place", name)


def unsound(place: Path, name: str) -> list[str]:
    """Return what is wrong with the results of two calls."""
    if name in ("run", "inverse", "rerun"):
        return [f"the archive of two calls of {name}: {problem}" for problem in check(place / "out.h5")]
    if name in ("study", "blocks", "design"):
        if _results(place / "out") != _results(whole() / name):
            return [f"two calls of {name} have other results than one"]
        with contextlib.suppress(FileNotFoundError), h5py.File(place / "out" / "index.h5") as file:
            assert file.attrs["data_sha256"]
    return []


ATTACKS = (
    Attack(
        "folders", "damaged or exchanged files in folders of studies and designs: refused, or made again", 600, damage
    ),
    Attack("forbidden", "folders and files of somebody else: a sentence, and every old file as it was", 200, forbidden),
    Attack(
        "pairs", "two calls write the same file or folder: one at least succeeds, and its result is sound", 200, pair
    ),
)
