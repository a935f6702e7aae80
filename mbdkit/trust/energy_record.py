"""Largest energies and largest energy errors of a run, from its recorded rows."""

from __future__ import annotations

import numpy as np


class EnergyRecord:
    """Collects the energies of consecutive rows.

    Attributes
    ----------
    kinetic, energy
        Largest kinetic energy, and largest absolute value of any energy [J].
    balance
        Largest absolute energy balance [J].
    """

    def __init__(self) -> None:
        self.kinetic = self.energy = self.balance = 0.0

    def add(self, kinetic: np.ndarray, others: np.ndarray, balance: np.ndarray) -> None:
        """Update the largest values with further rows.

        Parameters
        ----------
        kinetic, balance
            (T,) kinetic energies and energy balances [J].
        others
            (K, T) other energies: potential, work, dissipated [J].
        """
        if not len(kinetic):
            return
        (new,) = EnergyRecord.of_runs(kinetic[None], others[:, None], balance[None])
        # np.max, because max would ignore nan
        self.kinetic = float(np.max([self.kinetic, new.kinetic]))
        self.energy = float(np.max([self.energy, self.kinetic, new.energy]))
        self.balance = float(np.max([self.balance, new.balance]))

    @classmethod
    def of_runs(cls, kinetic: np.ndarray, others: np.ndarray, balance: np.ndarray) -> list[EnergyRecord]:
        """Return the record of each of R runs.

        Parameters
        ----------
        kinetic, balance
            (R, T) kinetic energies and energy balances [J].
        others
            (K, R, T) other energies: potential, work, dissipated [J].
        """
        largest = np.max(kinetic, axis=1, initial=0.0)
        energy = np.max(np.abs(others), axis=(0, 2), initial=0.0)
        records = []
        for values in zip(
            largest.tolist(),
            np.maximum(largest, energy).tolist(),
            np.max(np.abs(balance), axis=1, initial=0.0).tolist(),
            strict=True,
        ):
            record = cls()
            record.kinetic, record.energy, record.balance = values
            records.append(record)
        return records
