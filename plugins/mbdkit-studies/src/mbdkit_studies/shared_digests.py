"""Digests of arrays that are equal in all runs of a vector."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mbdkit.archive.finished_run import ArrayHash


class SharedDigests:
    """Finds arrays that are equal in many runs, such as the times, and computes their digests only once.

    Parameters
    ----------
    hashes
        Computes the digests.
    """

    def __init__(self, hashes: ArrayHash):
        self._hash = hashes
        self._latest: dict[str, tuple[np.ndarray, str]] | None = None

    def of(self, arrays: Mapping[str, np.ndarray]) -> dict[str, str]:
        """Return the digests of arrays that are equal in all of several runs.

        Parameters
        ----------
        arrays
            Contiguous numbers (R, ...) of the R runs by `Array.key`, with the same keys in every call. Arrays that
            differed between runs in the first call are not compared again.
        """
        first, self._latest = self._latest is None, self._latest or {}
        for key in list(arrays if first else self._latest):
            bits = arrays[key].view(np.int64)  # compared bitwise: nan equals itself, and 0.0 differs from -0.0
            if key in self._latest and (bits == self._latest[key][0]).all():
                continue
            if (first or len(bits) > 1) and (bits == bits[:1]).all():
                self._latest[key] = bits[0].copy(), self._hash.digest(arrays[key][0])
            else:
                self._latest.pop(key, None)
        return {key: digest for key, (_, digest) in self._latest.items()}
