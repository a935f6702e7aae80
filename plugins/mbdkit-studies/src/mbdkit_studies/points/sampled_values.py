"""The values that distinguish the runs of a study with a sample, with tolerances or with a table of members.

Those of a sample are points of ``scipy.stats.qmc``, transformed by the quantile functions of the variables. With
tolerances, the runs are the base, each number at its limits, and corners of the box of all limits.
"""

from __future__ import annotations

from itertools import product

import numpy as np

import mbdkit_gradients  # whose names are loaded when they are used
from mbdkit.base.errors import MbdkitError, SpecError
from mbdkit.base.plain_data import Path, copied, path_text
from mbdkit.spec.estimates import Estimated
from mbdkit.spec.reading import parse_key, put
from mbdkit.spec.run_spec import RunSpec
from mbdkit_studies.folder import member_table
from mbdkit_studies.folder.study_folder import StudyFolder
from mbdkit_studies.spec.sample_section import Sample, frozen
from mbdkit_studies.spec.study_loading import load_study_spec
from mbdkit_studies.spec.study_spec import Members, StudySpec
from mbdkit_studies.spec.value_sets import DIGITS

#: Smallest coordinate of a point; it replaces 0, whose quantile is infinite for many distributions.
_SMALLEST = 2.0**-54


def sampled_values(sample: Sample, estimated: Estimated | None = None) -> dict[str, np.ndarray]:
    """Return the values of each variable, (N,) by dotted key, where N is the number of runs.

    The runs of each member of the sample are consecutive. In a Saltelli design with d variables, a member has one run
    with a point of the matrix A, one with a point of B, and d runs with the point of A in which one coordinate is taken
    from B. In other designs, a member is one run.

    Parameters
    ----------
    estimated
        Parameters that are drawn from the joint normal distribution of their estimates; None for none.

    Raises
    ------
    SpecError
        If a value is not finite. The key of the error is relative to the section ``sample``.
    """
    d = len(sample.variables)
    if sample.design == "plain":
        points = unit_points(sample, d + (0 if estimated is None else len(estimated.names)))
    else:
        both = unit_points(sample, 2 * d)
        first, second = both[:, :d], both[:, d:]
        runs = np.repeat(first[:, None, :], d + 2, axis=1)
        runs[:, 1] = second
        place = np.arange(d)
        runs[:, 2 + place, place] = second
        points = runs.reshape(-1, d)
    values = {}
    for column, (key, distribution) in enumerate(sample.variables.items()):
        with np.errstate(all="ignore"):
            values[key] = np.asarray(frozen(distribution).ppf(points[:, column]), np.float64)
        if not np.all(np.isfinite(values[key])):
            message = "the distribution yields values that are too large for double precision"
            raise SpecError(message, key=path_text(("variables", key)))
    if estimated is not None:
        from scipy.special import ndtri

        drawn = estimated.values + ndtri(points[:, d:]) @ estimated.factor.T
        values |= {f"parameters.{name}": column for name, column in zip(estimated.names, drawn.T, strict=True)}
    return values


def unit_points(sample: Sample, dimensions: int) -> np.ndarray:
    """Return the points of a sample in the unit cube, (n, dimensions), above 0 and below 1."""
    from scipy.stats import qmc

    random = np.random.default_rng(sample.seed)
    match sample.method:
        case "sobol":  # a power of 2, because SciPy warns about other numbers of points
            points = qmc.Sobol(dimensions, seed=random).random_base2((sample.n - 1).bit_length())[: sample.n]
        case "halton":
            points = qmc.Halton(dimensions, seed=random).random(sample.n)
        case "latin-hypercube":
            points = qmc.LatinHypercube(dimensions, seed=random).random(sample.n)
        case "random":
            points = random.random((sample.n, dimensions))
    return np.asarray(np.clip(points, _SMALLEST, 1.0 - 2.0**-53))


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
        parameters = mbdkit_gradients.resolved(base, names)
        if len(names) > MOST_FOR_ALL_CORNERS:
            own = [one for one in spec.defined_measures() if one.expression]
            measures = {one.name: {"value": one.expression, "unit": one.unit} for one in own}
            slopes = np.sign(mbdkit_gradients.gradient(base, measures, names, check=False).jacobian)
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


def with_sample_values(spec: StudySpec, folder: StudyFolder, *, overwrite: bool = False) -> StudySpec:
    """Return a study with the table of the values of its sample or of its corners; others are returned unchanged.

    The table in the folder is used if it belongs to the same study, so that a study continues with the same values even
    with another version of SciPy.
    """
    if spec.members is not None or not spec.has_table:
        return spec
    columns = values_of(spec)
    _, digest = member_table.image(columns)
    there = None if overwrite else study_in(folder)
    if there is not None and there.members is not None and there.members.sha256 != digest:
        untabled = there.with_members(None).stored_as(None)
        if untabled.sha256() == spec.stored_as(None).sha256():
            tabled = spec.with_members(there.members)
            tabled._folder = folder.path
            return tabled
    tabled = spec.with_members(Members(runs=rows_of(spec), sha256=digest))
    tabled._columns = columns
    return tabled


def study_in(folder: StudyFolder) -> StudySpec | None:
    """Return the study in a folder; None if it cannot be read, which is reported elsewhere."""
    if not folder.spec.is_file():
        return None
    try:
        return load_study_spec(folder.spec)
    except MbdkitError:
        return None


def values_of(spec: StudySpec) -> dict[str, np.ndarray]:
    """Return the values that distinguish the runs of a study, (N,) by dotted key; empty for a study with axes only.

    Raises
    ------
    SpecError
        If the table of members is missing or damaged, or a value of the sample is not finite.
    """
    if spec.members is not None:
        return member_table.read_members(spec)
    if not spec.has_table:
        return {}
    if spec._columns is None:
        if spec.sample is None:
            spec._columns = corner_values(spec)
        else:
            estimated = spec.estimated()
            with SpecError.place_by(lambda error: spec.placed(error.located(prefix="sample"))):
                spec._columns = sampled_values(spec.sample, estimated)
    return spec._columns


def rows_of(spec: StudySpec) -> int:
    """Return the number of rows of `values_of`; 1 for a study with axes only."""
    if spec.members is not None:
        return spec.members.runs
    if spec.sample is not None:
        return spec.sample.runs
    return len(next(iter(values_of(spec).values()), (0,)))


def table_place(spec: StudySpec) -> Path:
    """Return the location in the study spec of the keys of `values_of`."""
    return ("tolerances",) if spec.tolerances else ("members",) if spec.sample is None else ("sample", "variables")
