"""Time per frame of inverse dynamics of the leg with a four-bar knee, archive included.

``python -m tests.benchmarks.inverse_frames [FRAMES]``
"""

from __future__ import annotations

import sys
import time

import numpy as np

import mbdkit
from mbdkit.spec import load_spec


def main(frames: int) -> None:
    """Print the time of the second of two computations of a swing of the knee."""
    model = load_spec("knee").mechanism().to_spec()
    run = mbdkit.run("knee", time={"end": 1.0, "step": 0.001})
    t = np.linspace(0.0, 1.0, frames)
    data = {"time": t, "shank": np.interp(t, run.time, run["shank"].angle)}
    smooth = {"name": "butterworth", "cutoff": 20.0}
    motion = {"data": data, "columns": {"shank.angle": "shank"}, "smooth": smooth}
    spec = {"mbdkit": 1, "model": model, "motion": motion, "actuators": {"knee": {"joint": "A"}}}
    for _ in range(2):
        begin = time.perf_counter()
        mbdkit.inverse(spec)
        taken = time.perf_counter() - begin
    print(f"{frames} frames in {taken:.3g} s: {1e3 * taken / frames:.3g} ms a frame")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
