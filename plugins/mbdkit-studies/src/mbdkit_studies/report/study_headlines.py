"""The main results of a study: mean, spread and quantiles of each measure with confidence intervals, which variables
explain them, numerical errors, extreme runs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed, plus_minus, told_apart
from mbdkit_report import key_words
from mbdkit_studies.report.worst_cases import worst_cases
from mbdkit_studies.results.cost_at_error import error_headlines
from mbdkit_studies.statistics.sample_groups import SampleGroup, measured, sample_groups
from mbdkit_studies.statistics.sample_statistics import (
    Estimate,
    MeasureStatistics,
    squared_correlation,
    statistics_of_group,
)
from mbdkit_studies.statistics.sobol_indices import Sensitivity, members_for
from mbdkit_studies.store.study_point import axis_unit, point_words
from mbdkit_studies.study import Study
from mbdkit_studies.texts import ERROR

MOST = 5  #: Largest number of measures, and of samples of a study, in the headlines.

#: Headlines mention a variable if it explains at least this share of the variance of a measure, and interactions if
#: they do.
LEAST_SHARE = 0.05

#: Headlines do not mention Sobol indices whose confidence intervals are wider than the first number. They then
#: recommend a number of members for which the widths are about the second number.
WIDEST, WANTED = 0.5, 0.2

#: Smallest number of members whose Sobol indices are mentioned.
#:
#: For the Ishigami function and a product of three variables, 95 % intervals from 8 to 16 random members contain the
#: index in 80 to 95 % of the samples, those from 32 members in 87 to 96 %, and those from 128 members in 90 to 96 %
#: (`tests.benchmarks.study_intervals`).
FEWEST_MEMBERS = 32

#: Largest number of variables in a headline. Up to three others follow if their order is uncertain.
MOST_CAUSES = 3

#: If the relative range of a measure is below this, its values differ by rounding errors only.
ROUND_OFF = 1e-12

#: Errors of runs are mentioned as a part of the spread of a measure if they exceed this share of its standard
#: deviation.
SMALL_ERRORS = 0.1


def headlines(study: Study, sign: str = "+-") -> list[tuple[str, str]]:
    """Return pairs of a name and a text about the values of each measure that the study or its base defines.

    At most `MOST` measures are included; measures with equal values share a pair. In studies with a reference, the
    first pairs are about the errors of the runs, and the cost of runs at a given error. A study with a verdict of its
    own has no pairs about measures, because the verdict says what they mean.

    Parameters
    ----------
    sign
        Sign between a number and its error.
    """
    if study.spec.tolerances:
        return [(one.name, one.headline(sign)) for one in worst_cases(study)][:MOST]
    names = [] if study.spec.verdict else [measure.name for measure in study.spec.defined_measures()]
    of_errors = [] if study.spec.has_table else error_headlines(study)
    groups = sample_groups(study)[:MOST] if study.spec.has_table else [SampleGroup("", {}, range(len(study.points)))]
    return of_errors + [
        (f"{listed(same)} ({group.words})" if group.words else listed(same), told)
        for same in _equal(study, names)[:MOST]
        for group in groups
        if (told := _told(study, group, same[0], sign))
    ]


def _equal(study: Study, names: Sequence[str]) -> list[list[str]]:
    """Return the names of measures, with those of equal values in one list."""
    columns = study.columns()
    found: list[list[str]] = []
    for name in names:
        if name in columns:
            same = next((one for one in found if np.array_equal(columns[one[0]], columns[name], equal_nan=True)), None)
            if same is None:
                found.append([name])
            elif study.described(same[0])[0] == study.described(name)[0]:
                same.append(name)
    return found


def _told(study: Study, group: SampleGroup, name: str, sign: str) -> str:
    try:
        values = measured(study, name, group.places)
    except MbdkitError:  # no run has a value
        return ""
    known = values[np.isfinite(values)]
    if not len(known):
        bad = int(np.sum(np.isfinite(measured(study, name, group.places, with_bad=True))))
        return f"unknown, because all {bad} runs with a value are rated bad" if bad else ""
    unit = study.described(name)[0].removesuffix("1")
    if np.ptp(known) <= ROUND_OFF * np.max(np.abs(known)):
        return f"{known[0]:.6g} {unit}".rstrip() + " in all runs"
    extremes = _extremes(study, group, name, values, sign)
    found = statistics_of_group(study, group, name) if study.spec.has_table else None
    if found is None:
        return extremes
    parts = [_spread(found, sign), _explained(study, group, name, values), _errors(study, group, found), extremes]
    return "; ".join(filter(None, parts))


def _spread(found: MeasureStatistics, sign: str) -> str:
    """Describe mean, standard deviation and quantiles; and the mean with bad runs if these change it."""
    half = 0.5 * (found.mean.high - found.mean.low)
    text = f"{plus_minus(found.mean.value, half, sign)} {found.unit}".rstrip() + " on average"
    if abs(found.mean_with_bad - found.mean.value) > half:
        text += f" ({found.mean_with_bad:.4g} {found.unit}".rstrip() + f" with the {found.bad} bad runs)"
    quantiles = [f"{100 * q:g} % quantile {one.text(found.unit)}" for q, one in found.quantiles.items() if q != 0.5]
    return f"{text}; {', '.join([f'standard deviation {found.std.text(found.unit)}', *quantiles])}"


def _errors(study: Study, group: SampleGroup, found: MeasureStatistics) -> str:
    """Describe the estimated errors of single runs, and compare them with the spread of the runs; empty if they are
    unknown.
    """
    if found.measure + ERROR not in study.columns():
        return ""
    errors = measured(study, found.measure + ERROR, group.places)
    errors = errors[np.isfinite(errors)]
    if not len(errors):
        return "the errors of the runs are unknown"
    middle = float(np.median(errors))
    told = f"error of a run {middle:.2g} {found.unit}".rstrip() + " (median)"
    told += f", at most {np.max(errors):.2g} {found.unit}".rstrip()
    if middle > SMALL_ERRORS * found.std.value:
        share = 100 * middle / found.std.value
        return f"{told}, which is {share:.0f} % of the standard deviation: THE SPREAD MAY BE NUMERICAL"
    if middle > 0.5 * (found.mean.high - found.mean.low):
        return f"{told}, which exceeds the interval of the mean"
    return told


def _explained(study: Study, group: SampleGroup, name: str, values: np.ndarray) -> str:
    """Describe which variables explain the variance: by Sobol indices in a Saltelli design, otherwise by a linear fit.

    The text is empty if no variable explains a sufficient share, or if this is unknown.
    """
    if (sample := study.spec.sample) is not None and sample.design == "saltelli":
        try:
            sobol = study.sensitivity(name, where=group.where or None)
        except MbdkitError as error:  # too few members have a value
            return str(error)
        return _sobol_words(sobol)
    known, table = np.isfinite(values), study.grid(group.family).table
    columns = {key: column[known] for key, column in table.items() if column.dtype.kind in "fi"}
    shares = {key: squared_correlation(one, values[known]) for key, one in columns.items() if np.ptp(one) > 0}
    ranked = {key: one for key, one in shares.items() if one.value >= LEAST_SHARE and one.low > 0}
    words = {key_words(key): f"{key_words(key)} explains {_share(one)}" for key, one in ranked.items()}
    told = _ranked(words, list(ranked.values()))
    return f"{told} (linear fit)" if told else ""


def _ranked(words: dict[str, str], shares: Sequence[Estimate]) -> str:
    """List the variables with the largest shares, and say of which the order is uncertain.

    Parameters
    ----------
    words
        Description of the share of each variable, by its name.
    shares
        The shares.
    """
    order = sorted(range(len(shares)), key=lambda place: -shares[place].value)

    def overlap(rank: int) -> bool:
        return shares[order[rank]].high >= shares[order[rank - 1]].low

    count = min(len(order), MOST_CAUSES)
    while count < min(len(order), 2 * MOST_CAUSES) and overlap(count):
        count += 1
    names = list(words)
    told = ", ".join(words[names[place]] for place in order[:count])
    groups: list[list[str]] = []
    for rank, place in enumerate(order[:count]):
        if rank and overlap(rank):
            groups[-1].append(names[place])
        else:
            groups.append([names[place]])
    uncertain = [listed(group, "and") for group in groups if len(group) > 1]
    return told + "".join(f", where the order of {one} is uncertain" for one in uncertain)


def _sobol_words(sobol: Sensitivity) -> str:
    """Describe the variables with the largest total indices.

    The text says so if the sample is too small to determine them, or if the values differ within their errors.
    """
    if sobol.reason:
        return f"no variable explains it: {sobol.reason[0].lower()}{sobol.reason[1:].rstrip('.')}"
    indices, count = sobol.indices, sobol.members
    widest = float(np.max(indices.total_high - indices.total_low))
    if not math.isfinite(widest):  # all values of a bootstrap sample are equal
        return f"the sample of {count} members is too small to tell which variables explain it"
    if widest > WIDEST or np.any(np.isnan(sobol.total)) or count < FEWEST_MEMBERS:
        more = max(members_for(count, widest, WANTED), 2 * FEWEST_MEMBERS)
        return (
            f"the sample is too small to tell which variables explain it: from {count} members, the intervals of the "
            f"shares are up to {100 * widest:.0f} % wide; about sample.n={more} makes them {100 * WANTED:.0f} % wide"
        )
    firsts, totals = (map(Estimate, *(ends.tolist() for ends in some)) for some in indices.with_intervals)
    rows = {
        key_words(key): (first, total)
        for key, first, total in zip(sobol.variables, firsts, totals, strict=True)
        if total.value >= LEAST_SHARE
    }
    words = {key: _shares(key, first, total) for key, (first, total) in rows.items()}
    told = _ranked(words, [total for _, total in rows.values()])
    left = f" (without {sobol.left_out} of {count + sobol.left_out} members)" if sobol.left_out and told else ""
    return told + left


def _shares(variable: str, first: Estimate, total: Estimate) -> str:
    """Describe the first-order index of a variable, which may be unknown, and its total index."""
    if total.value - first.value < LEAST_SHARE:
        return f"{variable} explains {_share(total)}"
    alone = f"{_share(first)} alone and " if first.high - first.low <= WIDEST else ""
    return f"{variable} explains {alone}{_share(total)} with interactions"


def _share(share: Estimate) -> str:
    """Return a share with its interval in percent; estimates of indices may lie outside 0 to 1."""
    value, low, high = (100 * min(max(one, 0.0), 1.0) for one in (share.value, share.low, share.high))
    return Estimate(value, low, high).text("%", most_decimals=1)


def _extremes(study: Study, group: SampleGroup, name: str, values: np.ndarray, sign: str) -> str:
    """Describe the runs with the smallest and the largest value."""
    unit, columns = study.described(name)[0].removesuffix("1"), study.columns()
    parts, places = [], (int(np.nanargmin(values)), int(np.nanargmax(values)))
    numbers = told_apart(float(values[places[0]]), float(values[places[1]]), digits=4)
    for word, place, number in zip(("smallest", "largest"), places, numbers, strict=True):
        point = study.points[group.places[place]]
        words = point_words(point, {key: axis_unit(key, [point]) for key in point.axes})
        error = float(columns[name + ERROR][group.places[place]]) if name + ERROR in columns else math.nan
        value = number if math.isnan(error) else plus_minus(float(values[place]), error, sign)
        parts.append(f"{word} {f'{value} {unit}'.rstrip()} in run {point.number}{f' ({words})' if words else ''}")
    return ", ".join(parts)
