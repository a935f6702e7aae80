"""`python -m tests.benchmarks person-times`: time of inverse dynamics of a person with two legs and 22 muscles.

The person is the one of `person_markers`, with the muscles of the example `walking-two-legs` and the default
uncertainty. The knees have landmarks, and their compartments bound the forces in a quarter of the frames; the same
person is timed without bounds. The whole command is timed, with reading the markers and writing the archive.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from mbdkit.spec.loading import read_source

from .person_markers import CLUSTERS, Walker, columns_of, table_text

FRAMES = (262, 780)
"""Numbers of frames of the trials."""
SAMPLES = 500
"""Number of samples of person and muscles."""
BESIDE = 0.04
"""Distance of the ground's forces from the knees, on the medial side [m]; that in walking is up to 0.03 to 0.04 m."""


def resampled(frames: int) -> Walker:
    """Return the person of the example `walking-two-legs` with another number of frames in the same time."""
    own = Walker.of_example()
    at = np.linspace(own.time[0], own.time[-1], frames)

    def at_times(values: np.ndarray) -> np.ndarray:
        columns = np.nan_to_num(values.reshape(len(values), -1))
        return np.stack([np.interp(at, own.time, one) for one in columns.T], axis=-1).reshape(-1, *values.shape[1:])

    loads = {foot: (at_times(force), at_times(point)) for foot, (force, point) in own.loads.items()}
    angles = {body: at_times(angle) for body, angle in own.angles.items()}
    return Walker(at, angles, at_times(own.hip), loads)


def trial(frames: int, folder: Path, **sections: Any) -> Path:
    """Write markers and plates of a trial and its spec into a folder; return the file of the spec."""
    walker = resampled(frames)
    columns = columns_of(walker, walker.markers(np.random.default_rng(76)))
    for number, (foot, *_) in enumerate(walker.contacts(), 1):
        columns[f"plate{number}.point"][:, 1] += BESIDE if foot == "foot" else -BESIDE
    (folder / "trial.csv").write_text(table_text(walker.time, columns), encoding="utf-8")
    muscles = read_source("walking-two-legs").data["model"]["muscles"]
    spec = {
        "mbdkit": 1,
        "subject": {"mass": 75, "height": 1.8, "sex": "male"},
        "model": {"name": "leg", "legs": 2, "root": "trunk", "symmetric_muscles": True, "muscles": muscles},
        "motion": {
            "file": "trial.csv",
            "clusters": CLUSTERS,
            "smooth": {"name": "butterworth", "cutoff": 8},
        },
        "recruitment": {"exponent": 2, "minimum": 0.01, "reserves": 1.0},
        "uncertainty": {"samples": SAMPLES},
        **sections,
    }
    file = folder / "trial.json"
    file.write_text(json.dumps(spec), encoding="utf-8")
    return file


def person_times(console: Console) -> None:
    """Print wall and processor times of the command `mbdkit inverse`."""
    title = f"mbdkit inverse, two legs, 22 muscles, {SAMPLES} samples, {os.cpu_count()} processors"
    table = Table("frames", "compartments", "seconds", "processor seconds", title=title)
    for frames, frontal in product(FRAMES, (None, "none")):
        with tempfile.TemporaryDirectory() as folder:
            file = trial(frames, Path(folder), frontal=frontal)
            before, begin = _processor_seconds(), time.perf_counter()
            words = [sys.executable, "-m", "mbdkit", "inverse", str(file), "-o", f"{folder}/trial.h5"]
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            wall = time.perf_counter() - begin
            used = f"{_processor_seconds() - before:.1f}"
            table.add_row(str(frames), "no" if frontal else "yes", f"{wall:.1f}", used)
    console.print(table)


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
