"""The section `estimates` of a spec: named parameters that an identification has estimated, with their covariance."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import model_validator

from mbdkit.base import higher_layers
from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import plain, value_text
from mbdkit.base.text import listed
from mbdkit.mechanism.parameters import FROM, names_in
from mbdkit.spec.sections import Section

#: Pivots of the Cholesky factorization below this share of the variance count as zero: the estimates before determine
#: this one.
SINGULAR = 1e-12


class Estimated(NamedTuple):
    """K estimated parameters: their names, their values (K,), and the lower Cholesky factor (K, K) of their covariance,
    in SI units.
    """

    names: tuple[str, ...]
    values: np.ndarray
    factor: np.ndarray


class Estimates(Section):
    """Named parameters that an identification has estimated. `parameters: {from: FILE.h5}` writes this section when a
    spec is loaded.
    """

    values: dict[str, float]
    """Estimates by name of the parameter, in SI units. A parameter to which `parameters` gives another value does not
    count as estimated."""
    covariance: tuple[tuple[float, ...], ...]
    """Covariance of the estimates, in SI units: a row for each of `values`, in their order."""

    @model_validator(mode="after")
    def _consistent(self) -> Estimates:
        count = len(self.values)
        if [len(row) for row in self.covariance] != [count] * count:
            raise SpecError(f"should have {count} rows of {count} numbers, as there are `values`", key="covariance")
        cholesky_factor(self._matrix)
        return self

    @property
    def _matrix(self) -> np.ndarray:
        return np.reshape(self.covariance, 2 * (len(self.values),))

    def within(self, parameters: Mapping[str, object]) -> Estimated:
        """Return the parameters whose values in the section `parameters` are the estimates."""
        names, values = tuple(self.values), np.array([*self.values.values()])
        rows = [row for row, name in enumerate(names) if parameters.get(name) == values[row]]
        factor = cholesky_factor(self._matrix[np.ix_(rows, rows)])
        return Estimated(tuple(names[row] for row in rows), values[rows], factor)


def cholesky_factor(covariance: np.ndarray) -> np.ndarray:
    """Return the lower Cholesky factor of a covariance, which may be singular.

    Raises SpecError if the matrix is not the covariance of any numbers.
    """
    variances, factor = np.diagonal(covariance), np.zeros_like(covariance)
    for k, variance in enumerate(variances):
        column = covariance[k:, k] - factor[k:, :k] @ factor[k, :k]
        if column[0] > SINGULAR * variance:
            factor[k:, k] = column / np.sqrt(column[0])
    sizes = np.sqrt(np.abs(np.outer(variances, variances)))
    # Leaving out a pivot changes covariances by up to the root of its share.
    if not np.all(np.abs(covariance - factor @ factor.T) <= 2.0 * np.sqrt(SINGULAR) * sizes):
        raise SpecError("should be symmetric and have no negative eigenvalue", key="covariance")
    return factor


def read_estimates(data: dict[str, Any], folder: Path) -> None:
    """Replace `from` among the named parameters of a spec, given as plain data, by the estimates in this file.

    They become numbers of `parameters`, and the section `estimates`. Those are taken for which `parameters` gives no
    number, and whose name a text of the spec contains. `folder`: folder of the spec. Raises SpecError if the file is
    not the result of an identification, or if it has no covariance of a parameter that is taken.
    """
    if not isinstance(data.get("parameters"), Mapping) or FROM not in data["parameters"]:
        return
    texts = plain(data)
    parameters, key = texts["parameters"], f"parameters.{FROM}"
    if not isinstance(file := parameters.pop(FROM), str):
        raise SpecError(f"should be the file of an identification, not {value_text(file)}", key=key)
    names, values, covariance, reasons = higher_layers.identified_parameters(folder / file)
    used = names_in(texts)
    rows = [row for row, name in enumerate(names) if name in used and name not in parameters]
    if not rows and not parameters.keys() & set(names):
        message = f"has no effect: no expression contains a parameter of {file}, which has {listed(names, 'and')}"
        raise SpecError(message, key=key)
    if unknown := [f"'{names[row]}' ({reasons[row]})" for row in rows if reasons[row]]:
        message = f"{file} has no estimate with a covariance of {listed(unknown, 'and')}; give a number beside `from`"
        raise SpecError(message, key=key)
    taken = {names[row]: float(values[row]) for row in rows}
    data["parameters"] = taken | parameters
    data.pop("estimates", None)
    if taken:
        data["estimates"] = {"values": taken, "covariance": covariance[np.ix_(rows, rows)].tolist()}
