"""Discontinuities of the laws of elements, at which the steps of runs with derivatives end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Never, Protocol

import numpy as np

from mbdkit.registry.seam import OwnSeam

if TYPE_CHECKING:
    from mbdkit.engine.kernels.observe import Observed


class LawCondition(Protocol):
    """A condition of a law, which holds where a function g of the state is positive."""

    @property
    def force(self) -> str:
        """Name of the element."""

    @property
    def side(self) -> int:
        """Index in ``Topology.law_parameters`` of the parameter that says on which side the law is evaluated."""

    @property
    def bodies(self) -> tuple[int, ...]:
        """Indices of the bodies on whose states it depends."""

    @property
    def parameters(self) -> np.ndarray:
        """Indices in ``Topology.law_parameters`` of the number of the parameters of the law, and of these."""

    def values(self, observed: Observed, q: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> list[float]:
        """Return g in T states.

        `observed`: quantities of the states. `q`, `v`: (T, n) positions and velocities. `numbers`: (L,) parameters of
        all laws.
        """

    def slopes(self, state: tuple[np.ndarray, ...], directions: Sequence[tuple[np.ndarray, ...]]) -> list[float]:
        """Return the derivatives of g in directions of the state: positions (n,), velocities (n,), parameters (L,)."""


@OwnSeam
def law_sides(handle: Never, places_of: Callable[[int], np.ndarray], /) -> Iterable[LawCondition]:
    """Return the conditions of the laws of elements.

    `places_of` takes the index of a law and returns the indices in ``Topology.law_parameters`` of its parameters, with
    their number first.
    """
    raise NotImplementedError


@OwnSeam
def gradient_doubts(handle: Never, /) -> Iterable[str]:
    """Return doubts about derivatives of runs with these elements."""
    raise NotImplementedError
