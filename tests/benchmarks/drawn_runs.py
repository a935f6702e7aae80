"""Runs drawn from studies in blocks, compared bit by bit with single runs.

``python -m tests.benchmarks.drawn_runs`` computes studies of all built-in methods with 2, 4 and 8 lanes, in one thread
and in two, and compares the first and last run of each block, failed runs, and others drawn at random with the same
specs run alone: arrays and their hash, status, reasons, counters, misalignment and all measures. It then makes 100 of
the runs again by `Study.remake`. It ends with status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import mbdkit
from mbdkit.archive import layout
from mbdkit.base.errors import SpecError
from mbdkit.engine.native.levels import WIDTH, is_able, this_platform
from mbdkit.quantities.array import TEXT
from mbdkit.spec import RunSpec
from mbdkit.spec.reading import parse_key, put
from mbdkit_studies.compute.carry_out import load_study
from mbdkit_studies.compute.compute_block import compute_block
from mbdkit_studies.folder import member_table
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.measures import MEASURES
from mbdkit_studies.spec.study_loading import load_study_spec

from .bits import VARIANTS

MEMBERS = 24
BLOCK = 9
STORES = ("all", "hashes")
BASE: dict[str, Any] = {
    "mbdkit": 1,
    "model": {"name": "double-pendulum", "angles": [0.0, 0.0], "masses": [1.0, 1.0], "rates": [0.0, 0.0]},
    "time": {"end": 0.4, "step": 0.01},
    "limits": {"max_steps": 10000, "misalignment": 1.0},
    "measures": {"pull": "max(abs(joints.J1.force))", "turn": {"value": "final(rod2.angle)", "unit": "deg"}},
}


def columns(kind: str, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the values of the members: of the model only, one of them refused, or of settings, some of which fail."""
    angles = {f"model.angles.{i}": rng.uniform(-3.0, 3.0, MEMBERS) for i in range(2)}
    if kind == "model":
        masses, rates = rng.uniform(0.5, 2.0, MEMBERS), rng.uniform(-9.0, 9.0, MEMBERS)
        masses[BLOCK], rates[3] = -1.0, -0.0
        return angles | {"model.masses.1": masses, "model.rates.0": rates}
    steps, share = np.full(MEMBERS, 10000), np.full(MEMBERS, 1.0)
    steps[[2, BLOCK - 1, MEMBERS - 1]] = 7
    share[[4, BLOCK]] = 1e-17
    return angles | {"limits.max_steps": steps, "limits.misalignment": share}


def computed(variant: str, kind: str, folder: Path, threads: int) -> mbdkit.Study:
    """Compute a study by this number of threads, and return it."""
    number = list(VARIANTS).index(variant)
    values = columns(kind, np.random.default_rng([number, len(kind)]))
    _, digest = member_table.image(values)
    spec = load_study_spec(
        {
            "mbdkit_study": 1, "base": BASE | VARIANTS[variant], "store": STORES[number % len(STORES)], "block": BLOCK,
            "members": {"runs": MEMBERS, "sha256": digest},
        }
    )  # fmt: skip
    spec._columns = values
    StudyFolder(folder).prepare(spec)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda block: compute_block(folder, block, notify=_silent), range(-(-MEMBERS // BLOCK))))
    study = mbdkit.study(spec, out=folder)
    assert study.computed == 0
    return study


def _silent(message: str) -> None:
    """Discard a message."""


def drawn(study: mbdkit.Study, rng: np.random.Generator) -> list[int]:
    """Return places of runs: first and last of each block, those that failed, and two others."""
    ends = [place for place in range(MEMBERS) if place % BLOCK in (0, BLOCK - 1) or place == MEMBERS - 1]
    failed = [point.number - 1 for point in study.failures]
    return sorted({*ends, *failed, *rng.choice(MEMBERS, 2).tolist()})


def differences(study: mbdkit.Study, place: int, row: Any) -> Iterator[str]:
    """Yield what differs between a run of a study, with its row of the table, and the same spec run alone."""
    point = study.points[place]
    data = json.loads(json.dumps(dict(study.spec.base)))  # type: ignore[arg-type]
    for key, value in point.axes.items():
        put(data, parse_key(key), value)
    try:
        alone = mbdkit.run(RunSpec(**data))
    except SpecError as error:
        if row.status != "failed" or error.message not in row.status_reason:
            yield f"{row.status}, {row.status_reason} in the study, refused alone: {error}"
        return
    for name in ("status", "status_reason", "verdict", "data_sha256", "run_id", "misalignment_max"):
        if getattr(alone, name) != row[name]:
            yield f"{name}: {row[name]!r} in the study, {getattr(alone, name)!r} alone"
    measured = {name: measure.of(alone) for name, measure in MEASURES.items() if name in row.index} | alone.measures
    counted = {name: alone.stats[name] for name in layout.COUNTERS if name in alone.stats and name in row.index}
    for name, value in (measured | counted).items():
        if np.float64(value).tobytes() != np.float64(row[name]).tobytes() and not np.isnan([value, row[name]]).all():
            yield f"{name}: {row[name]!r} in the study, {value!r} alone"
    yield from _different_arrays(study, place, alone)


def _different_arrays(study: mbdkit.Study, place: int, alone: mbdkit.Run) -> Iterator[str]:
    if study.spec.store != "all":
        return
    stored = study.run(place)
    if stored is None:
        yield f"no results in the study: {study.points[place].reason}"
        return
    if dict(stored.measures) != dict(alone.measures) and not np.isnan([*alone.measures.values()]).any():
        yield f"measures: {stored.measures} in the study, {alone.measures} alone"
    for array in layout.every_array():
        if array.grows and not layout.is_timing(array.path) and alone.records(array.path):
            mine, theirs = stored.array(array.path), alone.array(array.path)
            if array.dtype == TEXT:
                same = mine.tolist() == theirs.tolist()
            else:
                same = mine.shape == theirs.shape and mine.tobytes() == theirs.astype(mine.dtype).tobytes()
            if not same:
                yield f"{array.path} differs"


def compare(variants: Sequence[str], threads: int, folder: Path) -> tuple[int, int, list[str]]:
    """Return the number of runs that were drawn, that of failed ones among them, and what differs."""
    count = failed = 0
    found = []
    for number, variant in enumerate(variants):
        for kind in ("model", "settings"):
            study = computed(variant, kind, folder / f"{number}-{kind}", threads)
            places = drawn(study, np.random.default_rng([number, threads]))
            count += len(places)
            failed += sum(study.points[place].status == "failed" for place in places)
            table = study.to_frame()
            for place in places:
                found += [
                    f"{variant}, {kind}, run {place + 1}: {one}" for one in differences(study, place, table.iloc[place])
                ]
    return count, failed, found


def remade(folder: Path, count: int) -> int:
    """Make runs of the studies in a folder again, drawn at random, and return their number; raise if one differs."""
    studies = [load_study(path) for path in sorted(folder.iterdir())]
    rng = np.random.default_rng(count)
    done = 0
    while done < count:
        study = studies[rng.integers(len(studies))]
        point = study.points[int(rng.integers(MEMBERS))]
        if study.run(point) is not None:
            study.remake(point)
            done += 1
    return done


def main() -> None:
    """Compare with each number of lanes, each in a process of its own."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.drawn_runs", description=__doc__)
    parser.add_argument("--only", default="", help="a part of the names of the methods")
    parser.add_argument("--here", action="store_true", help="in this process, with its number of lanes")
    parser.add_argument("--threads", type=int, nargs="*", default=[1, 2], help="numbers of threads")
    asked = parser.parse_args()
    if not asked.here:
        options = ["--only", asked.only, "--threads", *map(str, asked.threads)]
        command = [sys.executable, "-m", "tests.benchmarks.drawn_runs", "--here", *options]
        levels = [level.name for level in this_platform().levels if is_able(level)]
        codes = [subprocess.run(command, env=os.environ | {"MBDKIT_PROCESSOR": level}).returncode for level in levels]
        sys.exit(max(codes))
    variants = [name for name in VARIANTS if asked.only in name]
    differing = False
    for threads in asked.threads:
        with tempfile.TemporaryDirectory() as folder:
            count, failed, found = compare(variants, threads, Path(folder))
            again = remade(Path(folder), 17)
        print(
            f"{WIDTH} lanes, {threads} threads: {count} runs of {len(variants)} "
            f"methods, {failed} failed; {len(found)} differences; {again} made again",
            *found,
            sep="\n    ",
            flush=True,
        )
        differing |= bool(found)
    sys.exit(differing)


if __name__ == "__main__":
    main()
