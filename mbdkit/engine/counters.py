"""Counters of the work done in a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Counters:
    """Cost of a run; each part of the code counts the work it does itself."""

    steps: int = 0
    accepted: int = 0
    rejected: int = 0
    rhs_evaluations: int = 0
    jacobian_evaluations: int = 0
    factorizations: int = 0
    newton_iterations: int = 0
    projections: int = 0
