"""Time per frame of inverse dynamics: the leg with a four-bar knee, and a leg without loops, beside OpenSim's tool."""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import mbdkit

FRAMES = 10_000
DURATION = 20.0  # s
CUTOFF = 6.0  # Hz
REPEATS = 3
PLUGIN_TESTS = Path(__file__).parents[2] / "plugins" / "mbdkit-opensim" / "tests"
COORDINATES = {
    "pelvis_tilt": (0.1, 0.2, 3.0), "pelvis_tx": (0.2, 0.4, 2.0), "pelvis_ty": (0.9, 0.05, 7.0),
    "hip_flexion": (0.3, 0.4, 4.0), "knee_angle": (-1.0, 0.7, 5.0), "ankle_angle": (0.0, 0.3, 6.0),
    "rail_x": (0.0, 0.2, 5.0), "swing": (0.5, 1.5, 3.0),
}  # fmt: skip
"""Mean, amplitude and angular frequency of the coordinates of the leg of the tests of mbdkit-opensim."""


def inverse_frames(console: Console) -> None:
    """Print times of `FRAMES` frames, files included; what is not installed is skipped, saying so."""
    time = np.linspace(0.0, DURATION, FRAMES)
    rows = Table("model", "program", "ms a frame", "what is computed", title=f"Inverse dynamics of {FRAMES} frames")
    with tempfile.TemporaryDirectory() as folder:
        rows.add_row("leg-four-bar", "mbdkit", _ours(_four_bar(time), Path(folder)), "actuators, joint forces, archive")
        for package, told in (("mbdkit_opensim", "mbdkit"), ("opensim", "InverseDynamicsTool of OpenSim")):
            if importlib.util.find_spec(package) is None:
                rows.add_row("leg.osim", told, "skipped", f"the package {package} is not installed")
                continue
            model, motion = _files(Path(folder), time)
            if package == "opensim":
                rows.add_row("leg.osim", told, _theirs(model, motion), "generalized forces, .sto")
                continue
            spec = _spec({"name": "opensim", "file": str(model)}, {"file": str(motion)})
            rows.add_row("leg.osim", told, _ours(spec, Path(folder)), "actuators, joint forces, archive")
    console.print(rows)


def _spec(model: dict[str, Any], motion: dict[str, Any]) -> dict[str, Any]:
    smooth = {"name": "opensim", "cutoff": CUTOFF}
    return {"mbdkit": 1, "model": model, "motion": {**motion, "smooth": smooth, "errors": "none"}}


def _four_bar(time: np.ndarray) -> dict[str, Any]:
    """Return the spec of the leg with a four-bar knee, on a fixed hip."""
    data = {
        "time": time,
        "hip_flexion": 0.3 * np.sin(4 * time),
        "knee_flexion": 0.6 + 0.5 * np.sin(5 * time),
        "ankle_dorsiflexion": 0.2 * np.sin(6 * time),
    }
    start = {name: float(values[0]) for name, values in data.items() if name != "time"}
    return _spec({"name": "leg-four-bar", **start}, {"data": data})


def _ours(spec: dict[str, Any], folder: Path) -> str:
    def computed() -> None:
        mbdkit.inverse(spec, archive=folder / "out.h5", overwrite=True).close()

    return _timed(computed)


def _files(folder: Path, time: np.ndarray) -> tuple[Path, Path]:
    """Write the model and the motion of the leg of OpenSim."""
    sys.path.insert(0, str(PLUGIN_TESTS))
    try:
        from osim_texts import leg
    finally:
        sys.path.remove(str(PLUGIN_TESTS))
    model, motion = folder / "leg.osim", folder / "leg.mot"
    model.write_text(leg(), encoding="utf-8")
    columns = [mean + size * np.sin(omega * time) for mean, size, omega in COORDINATES.values()]
    head = f"leg\nversion=1\nnRows={len(time)}\nnColumns={len(columns) + 1}\ninDegrees=no\nendheader\n"
    with motion.open("w", encoding="utf-8") as file:
        file.write(head + "\t".join(["time", *COORDINATES]) + "\n")
        np.savetxt(file, np.column_stack([time, *columns]), delimiter="\t", fmt="%.12g")
    return model, motion


def _theirs(model: Path, motion: Path) -> str:
    import opensim

    opensim.Logger.setLevelString("error")

    def computed() -> None:
        tool = opensim.InverseDynamicsTool()
        tool.setModelFileName(str(model))
        tool.setCoordinatesFileName(str(motion))
        tool.setLowpassCutoffFrequency(CUTOFF)
        tool.setStartTime(0.0)
        tool.setEndTime(DURATION)
        tool.setResultsDir(str(model.parent))
        tool.setOutputGenForceFileName("out.sto")
        if not tool.run():
            raise RuntimeError("OpenSim's tool failed")

    return _timed(computed)


def _timed(computed: Callable[[], None]) -> str:
    """Return the shortest time of a computation [ms] by frame."""
    times = []
    for _ in range(REPEATS):
        begin = perf_counter()
        computed()
        times.append(perf_counter() - begin)
    return f"{1e3 * min(times) / FRAMES:.3g}"
