"""Reads the estimates of parameters, with their covariance, from the result of an identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbdkit.archive.result_file import ResultFile
from mbdkit.base.files_read import read_data

FILE = ResultFile("mbdkit-identification", 1, "result of an identification", "repeat the identification")

LARGEST_FILE = 2**30  #: Largest size of a file [bytes].


def read_identified(path: Path) -> tuple[list[str], np.ndarray, np.ndarray, list[str]]:
    """Return the estimates of K parameters in a file, which is recorded as a file that was read.

    Returns the names of K parameters, their values (K,) and the covariance of these (K, K) in SI units, and for each
    why it has no covariance, empty if it has one. Values are estimates, or means of samples where bounds or curved
    effects matter. Raises SpecError if there is no such file, or if it is not the result of an identification. Raises
    ArchiveError if it is damaged.
    """
    read_data(path, LARGEST_FILE)
    with FILE.open(path) as file:
        group = file["parameters"]
        names = [str(name) for name in group["parameter"].asstr()[:]]
        values, means, covariance, known = (group[name][:] for name in ("value", "mean", "covariance", "identifiable"))
        count = len({*names})
        if not (values.shape == means.shape == known.shape == (len(names),) and covariance.shape == (count, count)):
            raise ValueError("it has not one row for each parameter")
        reasons = [str(why) for why in group["why"].asstr()[:]]
        for row, is_known in enumerate((known != 0) & np.isfinite(values)):
            if not is_known:
                reasons[row] = "the data do not determine it"
            elif not np.isfinite(covariance[row, row]):
                reasons[row] = f"no covariance describes it, because {reasons[row] or 'none is given'}"
            else:
                reasons[row] = ""
        return names, np.where(np.isfinite(means), means, values), covariance, reasons
