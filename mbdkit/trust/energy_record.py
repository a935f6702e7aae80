"""Largest energies and largest energy errors of a run, from its recorded rows."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def gravity_level(mass: np.ndarray, inertia: np.ndarray, gravity: np.ndarray) -> float:
    """Return the potential energy of bodies at the height of their radii of gyration [J].

    Joints round the coordinates of a body even if these are zero. The rounding errors of its potential energy are
    therefore not smaller than those of this energy.

    `mass`, `inertia`: (B,) masses [kg] and moments of inertia [kg m^2]. `gravity`: (2,) gravity [m/s^2].
    """
    return float(np.sum(np.sqrt(mass * inertia)) * np.sum(np.abs(gravity)))


class EnergyRecord:
    """Collects the energies of consecutive rows.

    `kinetic`, `energy`: largest kinetic energy, and largest absolute value of any energy [J]. `balance`: largest
    absolute energy balance [J]. `dissipated`, `regained`: largest dissipated energy, and its largest decrease below an
    earlier value [J].
    """

    def __init__(self) -> None:
        self.kinetic = self.energy = self.balance = self.dissipated = self.regained = 0.0

    @property
    def values(self) -> tuple[float, ...]:
        """All attributes, in the order of their description."""
        return self.kinetic, self.energy, self.balance, self.dissipated, self.regained

    @values.setter
    def values(self, values: Iterable[float]) -> None:
        self.kinetic, self.energy, self.balance, self.dissipated, self.regained = map(float, values)

    def add(self, kinetic: np.ndarray, others: np.ndarray, balance: np.ndarray) -> None:
        """Update the largest values with further rows.

        `kinetic`, `balance`: (T,) kinetic energies and energy balances [J]. `others`: (K, T) other energies: potential,
        work, dissipated [J].
        """
        if not len(kinetic):
            return
        others = np.hstack([np.full((len(others), 1), self.dissipated), others])
        new = EnergyRecord.of(largest_energies(kinetic[None], others[:, None], balance[None])[:, 0])
        # np.max, because max would ignore nan
        self.kinetic = float(np.max([self.kinetic, new.kinetic]))
        self.energy = float(np.max([self.energy, self.kinetic, new.energy]))
        self.balance = float(np.max([self.balance, new.balance]))
        self.dissipated, self.regained = new.dissipated, float(np.max([self.regained, new.regained]))

    @classmethod
    def of(cls, values: Iterable[float]) -> EnergyRecord:
        """Return a record with these values."""
        record = cls()
        record.values = values
        return record


def largest_energies(kinetic: np.ndarray, others: np.ndarray, balance: np.ndarray) -> np.ndarray:
    """Return the values of `EnergyRecord` of R runs, (5, R).

    `kinetic`, `balance`: (R, T) kinetic energies and energy balances [J]. `others`: (K, R, T) other energies:
    potential, work, dissipated [J].
    """
    largest = np.max(kinetic, axis=1, initial=0.0)
    energy = np.max(np.abs(others), axis=(0, 2), initial=0.0)
    peaks = np.maximum.accumulate(others[-1], axis=1)
    return np.stack(
        [
            largest,
            np.maximum(largest, energy),
            np.max(np.abs(balance), axis=1, initial=0.0),
            peaks.max(axis=1, initial=0.0),
            np.max(peaks - others[-1], axis=1, initial=0.0),
        ]
    )
