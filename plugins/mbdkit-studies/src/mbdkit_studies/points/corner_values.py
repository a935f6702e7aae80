"""The runs of a study with tolerances: the base, each number at its limits, and corners of the box of all limits."""

from __future__ import annotations

from itertools import product

import numpy as np

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import copied, path_text
from mbdkit.spec.reading import parse_key, put
from mbdkit.spec.run_spec import RunSpec
from mbdkit_gradients import gradient, resolved
from mbdkit_studies.spec.study_spec import StudySpec
from mbdkit_studies.spec.value_sets import DIGITS

MOST_FOR_ALL_CORNERS = 6
"""Largest number of tolerances of which all corners are computed; of more, gradients choose two for each measure."""


def corner_values(spec: StudySpec) -> dict[str, np.ndarray]:
    """Return the values of the numbers with tolerances, (N,) by key of the run spec; the first run is the base."""
    assert isinstance(spec.base, dict)
    with SpecError.place_by(lambda error: spec.placed(error.located(prefix="base"))):
        data = {"mbdkit": 1, **copied(spec.base)}
        for key, value in spec.overrides.items():
            put(data, parse_key(key), copied(value))
        base = RunSpec(**data)
    names = list(spec.tolerances)
    if not spec.defined_measures():
        raise spec.placed(SpecError("needs `measures`, whose worst cases are sought", key="tolerances"))
    with SpecError.place_by(spec.placed), SpecError.rekey("tolerances"):
        parameters = resolved(base, names)
        if len(names) > MOST_FOR_ALL_CORNERS:
            own = [one for one in spec.defined_measures() if one.expression]
            measures = {one.name: {"value": one.expression, "unit": one.unit} for one in own}
            slopes = np.sign(gradient(base, measures, names, check=False).jacobian)
            corners = np.vstack([slopes, -slopes])
        else:
            corners = np.array(list(product((-1, 1), repeat=len(names))))
    single = np.eye(len(names), dtype=int)
    sides = np.vstack([np.zeros_like(single[:1]), *np.stack([-single, single], axis=1), corners])
    limits = np.array([spec.tolerances[name].limits for name in names])
    values = np.array([one.value for one in parameters]) + np.where(sides > 0, limits[:, 1], limits[:, 0]) * abs(sides)
    rows = np.array(list(dict.fromkeys(tuple(float(f"{x:.{DIGITS}g}") for x in row) for row in values.tolist())))
    rows[0] = values[0]
    return {path_text(one.path): column for one, column in zip(parameters, rows.T, strict=True)}
