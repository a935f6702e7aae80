"""A chain whose markers are measured with gaps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from tests.inverse_dynamics.noisy_pendulum import pendulum

import mbdkit
from tests.benchmarks.drawn_mechanisms import Drawn, draw

TIME = np.linspace(0.0, 2.0, 201)


FILTER = {"name": "butterworth", "cutoff": 6.0}


DEVIATION = 0.003


PEAK = {"peak": "max(abs(actuators.hip.value))"}


def swing(seed: int, highest: float = 2.0) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """Return a random angle with frequencies up to `highest` [Hz], its torque, and the random numbers that follow."""
    random = np.random.default_rng(seed)
    omega = 2 * np.pi * highest * random.uniform(0.2, 1.0, 3)[:, None]
    size, phase = random.normal(0.0, 0.3, (3, 1)), random.uniform(0.0, 2 * np.pi, (3, 1))
    wave = size * np.sin(omega * TIME + phase)
    angle, acceleration = wave.sum(axis=0), (-(omega**2) * wave).sum(axis=0)
    return angle, 0.35 * acceleration + 0.5 * 9.81 * np.sin(angle), random


def start(decay: float, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Return an angle that starts suddenly from rest, an oscillation that decays at a rate [1/s], and its torque."""
    omega = 2 * np.pi * frequency
    size, cosine, sine = 0.5 * np.exp(-decay * TIME), np.cos(omega * TIME), np.sin(omega * TIME)
    angle = size * (1 - cosine)
    acceleration = size * (decay**2 * (1 - cosine) - 2 * decay * omega * sine + omega**2 * cosine)
    return angle, 0.35 * acceleration + 0.5 * 9.81 * np.sin(angle)


def measured(
    angle: np.ndarray,
    random: np.random.Generator,
    gap: slice | None = None,
    deviation: float = DEVIATION,
    measures: Mapping[str, str] = PEAK,
    **motion: Any,
) -> mbdkit.Run:
    """Return inverse dynamics of an angle with noise and a gap, by default with the largest torque as a measure."""
    noisy = angle + deviation * random.standard_normal(len(TIME))
    cells: list[float | None] = noisy.tolist()
    if gap is not None:
        cells[gap] = [None] * len(cells[gap])
        motion["gaps"] = {"longest": 1.0}
    spec = pendulum(**{"smooth": FILTER, "errors": {"samples": 60}, **motion})
    columns = motion.get("columns", {"hip.angle": "hip"})
    spec["motion"] |= {"data": {"time": TIME, "hip": cells}, "columns": columns}
    return mbdkit.inverse({**spec, "measures": measures})


def chain_with_gap(seed: int, rows: slice, offset: float = 0.0) -> tuple[Drawn, mbdkit.Run, mbdkit.Run]:
    """Return a random chain, whose motion is measured by three markers on each link with noise of 1 mm, its inverse
    dynamics from complete data, and that without a value of the last marker in some rows; the markers are off their
    places by `offset` [m] in x and y.
    """
    random = np.random.default_rng(seed)
    drawn = draw(random, "chain", "markers")
    time = drawn.values["time"]
    data = {"time": time}
    for number, key in enumerate(one for one in drawn.values if one != "time"):
        data[key] = drawn.values[key] + offset * (-1) ** number + 1e-3 * random.standard_normal(len(time))
    columns = {key: {"column": key, "deviation": 1e-3} for key in data if key != "time"}
    motion = {"data": data, "columns": columns, "smooth": {"name": "butterworth", "cutoff": 5 * drawn.highest}}
    motion |= {"gaps": {"longest": 1.0}, "errors": {"samples": 60}}
    spec = {"mbdkit": 1, "model": drawn.model, "actuators": drawn.actuators, "motion": motion}
    complete = mbdkit.inverse(spec)
    for key in list(data)[-2:]:
        data[key] = data[key].copy()
        data[key][rows] = np.nan
    return drawn, complete, mbdkit.inverse(spec)
