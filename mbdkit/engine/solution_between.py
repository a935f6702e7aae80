"""Solutions of the index-1 system with the Jacobians of two positions, as half-explicit methods need them."""

from __future__ import annotations

import numpy as np

from mbdkit.engine.elimination_order import new_factors
from mbdkit.engine.iteration_matrix import Pivots
from mbdkit.engine.kernels.between_positions import accelerations_between
from mbdkit.engine.kernels.equations import new_matrix
from mbdkit.engine.native.bundle import PinnedBundle
from mbdkit.engine.repeated_call import RepeatedCall


class SolutionBetween:
    """A kernel with its storage; see `mbdkit.engine.equations_of_motion.EquationsOfMotion.solve_between`.

    - `pivots`: the pivots of the matrix. `address`: address of the `Equations` bundle. `upper`: number of the terms of
      the matrix in rows of coordinates.
    - `q`, `force`, `q_end`, `v_end`, `x`, `mu`: (n,) arguments, and (n,) and (m,) results.
    - `solve`: takes the times of both positions and the factor of the accelerations, all as floats; returns the largest
      relative residual, or ``-1 - k`` if the pivot at position k has become too small.
    """

    def __init__(self, pivots: Pivots, address: int, upper: int):
        self.pivots = pivots
        factors = new_factors(pivots.pattern, np.float64)._replace(reference=pivots.reference)
        self._pinned = PinnedBundle(new_matrix(pivots.pattern, factors, pivots.scatter))
        n, m = pivots.shape
        self.q, self.force, self.q_end, self.v_end, self.x = np.zeros((5, n))
        self.mu = np.zeros(m)
        given = (None, self.q, self.force, None, self.q_end, self.v_end, None)
        self.solve = RepeatedCall(accelerations_between, address, self._pinned.address, upper, *given, self.x, self.mu)
