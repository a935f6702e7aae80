"""A workspace of the smallest mechanism, for compiling kernels and for the types of bundles."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.mechanism import Mechanism


def example_workspace() -> Workspace:
    """Return a workspace of a single free body; the types of its arrays are those of every workspace."""
    m = Mechanism()
    m.body("body", mass=1.0, inertia=1.0)
    return Workspace(compile_mechanism(m), 0.0, np.zeros(6), np.zeros(6))
