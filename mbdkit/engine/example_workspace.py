"""A workspace of a minimal mechanism, used to compile kernels and to determine the types of bundles."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.compile_mechanism import compile_mechanism
from mbdkit.engine.workspace import Workspace
from mbdkit.mechanism.mechanism import Mechanism


def example_workspace() -> Workspace:
    """Return a workspace of a single free body. Its arrays have the same types as those of any workspace."""
    m = Mechanism()
    m.body("body", mass=1.0, inertia=1.0)
    return Workspace(compile_mechanism(m), 0.0, np.zeros(6), np.zeros(6))
