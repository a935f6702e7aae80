"""The number of SIMD lanes: how many runs compiled code advances together (`mbdkit.engine.jit.lane_types`)."""

from __future__ import annotations

import os

from llvmlite import binding

from mbdkit.base.errors import MbdkitError

CHOICES = (2, 4, 8)


def _width() -> int:
    """Return ``MBDKIT_LANES`` if it is set, else the number of doubles in a vector register of this processor."""
    if chosen := os.environ.get("MBDKIT_LANES"):
        if chosen not in map(str, CHOICES):
            raise MbdkitError(f"the environment variable MBDKIT_LANES should be 2, 4 or 8, not '{chosen}'")
        return int(chosen)
    features = binding.get_host_cpu_features()
    if features.get("avx512f"):
        return 8
    return 4 if features.get("avx2") else 2


WIDTH = _width()
"""Number of lanes. The results of a run do not depend on it."""
