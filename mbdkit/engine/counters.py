"""Counters of the work done in a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Counters:
    """Numbers of steps, evaluations and factorizations of a run. Each module counts the work that it performs."""

    steps: int = 0
    accepted: int = 0
    rejected: int = 0
    rhs_evaluations: int = 0
    jacobian_evaluations: int = 0
    factorizations: int = 0
    newton_iterations: int = 0
    projections: int = 0


@dataclass
class HostCounters(Counters):
    """Counters of a method in Python, which does not pay for what mbdkit evaluates beside its steps."""

    host_evaluations: int = 0  #: Evaluations of the right-hand side by mbdkit, for work and for integrals over time.
