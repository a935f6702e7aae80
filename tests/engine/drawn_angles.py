"""Angles drawn at random, near and far."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.kernels.angles import FAR


def drawn(scale: float, count: int = 2000) -> np.ndarray:
    """Return random angles up to `scale`; half of them near multiples of pi/2, where cosine or sine vanishes."""
    rng = np.random.default_rng(1)
    x = rng.uniform(-scale, scale, count)
    near = np.round(x[::2] / (np.pi / 2)) * (np.pi / 2)
    x[::2] = near + rng.uniform(-1, 1, len(near)) * 10.0 ** rng.uniform(-20, 0, len(near))
    return np.clip(x, -FAR, FAR)
