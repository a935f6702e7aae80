"""Largest energies and energy errors of a run, from its recorded rows."""

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
        """Add rows.

        Parameters
        ----------
        kinetic, balance
            (T,) kinetic energies and energy balances [J].
        others
            (K, T) other energies: potential, work, dissipated [J].
        """
        if not len(kinetic):
            return
        # np.max, since max would ignore nan
        self.kinetic = float(np.max([self.kinetic, np.max(kinetic)]))
        self.energy = float(np.max([self.energy, self.kinetic, np.max(np.abs(others))]))
        self.balance = float(np.max([self.balance, np.max(np.abs(balance))]))
