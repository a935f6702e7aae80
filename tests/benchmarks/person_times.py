"""`python -m tests.benchmarks person-times`: time of inverse dynamics of a person with two legs and 22 muscles.

The person is the one of `person_markers`, with the muscles of the example `walking-two-legs` and the default
uncertainty. The knees have no landmarks, so that no compartments bound the forces, which would take longer. The whole
command is timed, with reading the markers and writing the archive.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
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
    text = table_text(walker.time, columns_of(walker, walker.markers(np.random.default_rng(76))))
    (folder / "trial.csv").write_text(text, encoding="utf-8")
    muscles = read_source("walking-two-legs").data["model"]["muscles"]
    spec = {
        "mbdkit": 1,
        "subject": {"mass": 75, "height": 1.8, "sex": "male"},
        "model": {"name": "leg", "legs": 2, "root": "trunk", "symmetric_muscles": True, "muscles": muscles},
        "motion": {
            "file": "trial.csv",
            "clusters": CLUSTERS,
            "centers": {"knee": "functional", "knee_left": "functional"},
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
    table = Table("frames", "seconds", "processor seconds", title=title)
    for frames in FRAMES:
        with tempfile.TemporaryDirectory() as folder:
            file, before, begin = trial(frames, Path(folder)), _processor_seconds(), time.perf_counter()
            words = [sys.executable, "-m", "mbdkit", "inverse", str(file), "-o", f"{folder}/trial.h5"]
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            wall = time.perf_counter() - begin
            table.add_row(str(frames), f"{wall:.1f}", f"{_processor_seconds() - before:.1f}")
    console.print(table)


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
