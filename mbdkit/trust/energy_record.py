"""Largest energies, energy errors and jumps of a run, from its recorded rows."""

from __future__ import annotations

import numpy as np

from mbdkit.trust.criteria import rounding


class EnergyRecord:
    """Collects the energies of consecutive rows.

    Attributes
    ----------
    kinetic, energy
        Largest kinetic energy, and largest absolute value of any energy [J].
    balance
        Largest absolute energy balance [J].
    jump, jump_time
        Largest change of the balance in one step [J] and the end of the interval in which it was found [s]. Of an
        interval of n steps only the change over all of them is known; at least one of the steps made an n-th of it.
    """

    def __init__(self) -> None:
        self.kinetic = self.energy = self.balance = self.jump = self.jump_time = 0.0
        self._last: float | None = None

    def add(
        self, time: np.ndarray, kinetic: np.ndarray, others: np.ndarray, balance: np.ndarray, steps: np.ndarray
    ) -> None:
        """Add rows.

        Parameters
        ----------
        time
            (T,) times [s].
        kinetic, balance
            (T,) kinetic energies and energy balances [J].
        others
            (K, T) other energies: potential, work, dissipated [J].
        steps
            (T,) steps in the interval that ends with each row; less than one step counts as one.
        """
        if not len(time):
            return
        jumps = self.jumps(balance, steps)
        self.kinetic = max(self.kinetic, float(np.max(kinetic)))
        self.energy = max(self.energy, self.kinetic, float(np.max(np.abs(others))))
        self.balance = max(self.balance, float(np.max(np.abs(balance))))
        row = int(np.argmax(jumps))
        if jumps[row] > self.jump:
            self.jump, self.jump_time = float(jumps[row]), float(time[row])
        self._last = float(balance[-1])

    def jumps(self, balance: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """Return (T,) the change of the balance in a step of the interval before each of the rows to be added [J]."""
        before = balance[:1] if self._last is None else [self._last]
        return np.asarray(np.abs(np.diff(balance, prepend=before)) / np.maximum(steps, 1.0))

    def first_jump(self, kinetic: np.ndarray, balance: np.ndarray, steps: np.ndarray, share: float) -> int | None:
        """Return the first of the rows to be added whose jump exceeds a share of the largest kinetic energy so far."""
        if not len(balance):
            return None
        so_far = np.maximum.accumulate(np.maximum(kinetic, self.kinetic))
        beyond = self.jumps(balance, steps) > np.maximum(share * so_far, rounding(max(self.energy, float(so_far[-1]))))
        return int(np.argmax(beyond)) if np.any(beyond) else None
