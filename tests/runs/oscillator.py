"""An oscillator with measures of known values."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

import mbdkit

END, A, W = 4.0, 1.0, 2.0


def oscillator(integrator: dict[str, Any], step: float | None, **sections: Any) -> dict[str, Any]:
    m = mbdkit.Mechanism(gravity=(0.0, 0.0))
    m.body("slider", mass=1.0, inertia=1.0, position=(A, 0.0))
    m.prismatic("rail", m.ground, "slider", at=(0, 0), axis=(1, 0))
    m.spring_damper("spring", m.ground, "slider", points=((-2.0, 0.0), (0.0, 0.0)), stiffness=W * W, free_length=2.0)
    time = {"end": END} | ({} if step is None else {"step": step})
    return {"mbdkit": 1, "model": m.to_spec(), "integrator": integrator, "time": time} | sections


def turns(level: float) -> np.ndarray:
    """Return the times until the end at which a cos(w t) passes a level."""
    phase = np.arccos(level / A)
    every = np.concatenate([(phase + 2 * np.pi * np.arange(9)) / W, (2 * np.pi * np.arange(1, 9) - phase) / W])
    return np.sort(every[every < END])


def above(level: float) -> tuple[float, float]:
    """Return the integral of max(x - level, 0), and its derivative by a, from its closed form between the turns."""
    ends = np.concatenate([[0.0], turns(level), [END]])
    parts = list(pairwise(ends))[::2]
    sines = sum(np.sin(W * b) - np.sin(W * a) for a, b in parts) / W
    return A * sines - level * sum(b - a for a, b in parts), sines


def path() -> float:
    """Return the integral of abs(v) for a = 1: the length of the path."""
    half_turns = int(W * END // np.pi)
    return 2 * half_turns + 1 - (-1) ** half_turns * np.cos(W * END)


EXACT = {
    "path": ("integral(abs(slider.vx))", path(), path()),
    "speed": ("mean(abs(slider.velocity))", path() / END, path() / END),
    "excess": ("integral(max(slider.x - 0.3, 0))", *above(0.3)),
    "peak": ("max(abs(slider.vx))", W * A, W),
    "lowest": ("min(slider.x)", -A, -1.0),
    # the peak of the smaller of two: x = 0.5 - x/2 at x = 1/3, whatever the amplitude
    "kinked": ("max(min(slider.x, 0.5 - slider.x/2))", 1 / 3, 0.0),
    "moment": ("at(slider.x, 1.234)", A * np.cos(W * 1.234), np.cos(W * 1.234)),
    "swing": ("integral(abs(slider.x - mean(slider.x)))", None, None),
}


TEXTS = {name: text for name, (text, _, _) in EXACT.items()}
