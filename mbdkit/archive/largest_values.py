"""Largest values of elements, with their bars."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class LargestValues(NamedTuple):
    """The largest values of E elements: in recorded rows and, where known, between them.

    - `value`: (E,) the largest values.
    - `bars`: (E, 2) how far the true values may lie below and above them; nan where unknown.
    - `recorded`: (E,) the largest values in the recorded rows.
    - `is_of_rows`: (E,) whether the value between rows is unknown, so that `value` is that of the rows.
    """

    value: np.ndarray
    bars: np.ndarray
    recorded: np.ndarray
    is_of_rows: np.ndarray

    @classmethod
    def of(cls, size: np.ndarray, missed: np.ndarray | None = None, errors: np.ndarray | None = None) -> LargestValues:
        """Return largest values.

        `size`: (T, E) values in the rows. `missed`: (E,) by how much the values between rows exceed them, nan where
        unknown; None if rows miss nothing. `errors`: (E,) errors of the largest values; None if they are unknown.
        """
        rows = np.argmax(np.nan_to_num(size), axis=0) if size.size else np.zeros(size.shape[1], int)
        recorded = np.take_along_axis(size, rows[None], axis=0)[0]
        beyond = np.zeros(len(recorded)) if missed is None else missed
        known = np.full(len(recorded), np.nan) if errors is None else np.where(np.isnan(beyond), np.nan, errors)
        value = recorded + np.nan_to_num(beyond)
        return cls(value, np.stack([known, known], axis=1), recorded, np.isnan(beyond))
