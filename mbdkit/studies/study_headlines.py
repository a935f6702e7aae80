"""The main results of a study: mean, spread and quantiles of each measure, which variables explain them, extreme
runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit.spec.key_words import key_words
from mbdkit.studies.cost_at_error import error_headlines
from mbdkit.studies.sample_groups import SampleGroup, measured, sample_groups
from mbdkit.studies.study_point import axis_unit, point_words

if TYPE_CHECKING:
    from mbdkit.studies.sensitivity import Sensitivity
    from mbdkit.studies.study import Study

MOST = 5
"""Largest number of measures, and of samples of a study, in the headlines."""

LEAST_SHARE = 0.05
"""Headlines mention a variable if it explains at least this share of the variance of a measure, and interactions if
they do."""

WIDEST = 0.5
"""Headlines do not mention Sobol indices whose confidence intervals are wider than this."""

MOST_CAUSES = 3
"""Largest number of variables in a headline."""

ROUND_OFF = 1e-12
"""If the relative range of a measure is below this, its values differ by rounding errors only."""


def headlines(study: Study) -> list[tuple[str, str]]:
    """Return pairs of a name and a text about the values of each measure that the study or its base defines.

    At most `MOST` measures are included. In studies with a reference, the first pairs are about the errors of the runs,
    and the cost of runs at a given error.
    """
    names = [measure.name for measure in study.spec.defined_measures()][:MOST]
    of_errors = [] if study.spec.has_table else error_headlines(study)
    groups = sample_groups(study)[:MOST] if study.spec.has_table else [SampleGroup("", {}, range(len(study.points)))]
    return of_errors + [
        (f"{name} ({group.words})" if group.words else name, told)
        for name in names
        for group in groups
        if (told := _told(study, group, name))
    ]


def _told(study: Study, group: SampleGroup, name: str) -> str:
    try:
        values = measured(study, name, group.places)
    except MbdkitError:  # no run has a value
        return ""
    known = values[np.isfinite(values)]
    if not len(known):
        return ""
    unit = study.described(name)[0].removesuffix("1")
    unit = f" {unit}" if unit else ""
    if np.ptp(known) <= ROUND_OFF * np.max(np.abs(known)):
        return f"{known[0]:.6g}{unit} in all runs"
    if not study.spec.has_table or len(known) < 3:
        return f"{known.min():.4g} to {known.max():.4g}{unit}; {_extremes(study, group, values)}"
    low, high = np.quantile(known, (0.05, 0.95))
    text = (
        f"{np.mean(known):.4g}{unit} on average, standard deviation {np.std(known, ddof=1):.3g}{unit}, "
        f"5 % to 95 %: {low:.4g} to {high:.4g}{unit}"
    )
    return "; ".join(filter(None, [text, _explained(study, group, name, values), _extremes(study, group, values)]))


def _explained(study: Study, group: SampleGroup, name: str, values: np.ndarray) -> str:
    """Describe which variables explain the variance: by Sobol indices in a Saltelli design, otherwise by a linear fit.

    The text is empty if no variable explains a sufficient share, or if this is unknown.
    """
    sample = study.spec.sample
    where = ({"family": group.family} if group.family else {}) | dict(group.axes)
    if sample is not None and sample.design == "saltelli":
        try:
            sobol = study.sensitivity(name, where=where or None)
        except MbdkitError:  # too few members have a value
            return ""
        return _sobol_words(sobol)
    known, table = np.isfinite(values), study.grid(group.family).table
    columns = {key: column[known] for key, column in table.items() if column.dtype.kind in "fi"}
    of = values[known]
    shares = {key: np.corrcoef(one, of)[0, 1] ** 2 for key, one in columns.items() if np.ptp(one) > 0}
    least = max(LEAST_SHARE, 4 / len(values))  # variables without an effect reach this share by chance
    ranked = sorted(((share, key) for key, share in shares.items() if share >= least), reverse=True)[:MOST_CAUSES]
    if not ranked:
        return ""
    return f"{listed([f'{key_words(key)} explains {_percent(share)}' for share, key in ranked], 'and')} (linear fit)"


def _sobol_words(sobol: Sensitivity) -> str:
    """Describe the variables with the largest total indices.

    The text is empty if all indices are unknown, and says that the sample is too small if any total index is uncertain.
    """
    if sobol.reason:
        return ""
    indices = sobol.indices
    if not np.all(indices.total_high - indices.total_low <= WIDEST) or np.any(np.isnan(sobol.total)):
        return "the sample is too small to tell which variables explain it"
    first = np.where(indices.first_high - indices.first_low <= WIDEST, sobol.first, np.nan)
    shares = sorted(zip(sobol.total.tolist(), first.tolist(), sobol.variables, strict=True), key=lambda one: -one[0])
    words = [_shares(key_words(key), first, total) for total, first, key in shares if total >= LEAST_SHARE]
    return listed(words[:MOST_CAUSES], "and")


def _shares(variable: str, first: float, total: float) -> str:
    """Describe the first-order index of a variable, which may be nan, and its total index."""
    if total - first < LEAST_SHARE:
        return f"{variable} explains {_percent(total)}"
    alone = "" if np.isnan(first) else f"{_percent(first)} alone and "
    return f"{variable} explains {alone}{_percent(total)} with interactions"


def _percent(share: float) -> str:
    """Return a share in percent; estimates of indices may lie outside 0 to 1."""
    return f"{100 * min(max(share, 0.0), 1.0):.0f} %"


def _extremes(study: Study, group: SampleGroup, values: np.ndarray) -> str:
    """Describe the runs with the smallest and the largest value."""
    parts = []
    for word, place in (("smallest", int(np.nanargmin(values))), ("largest", int(np.nanargmax(values)))):
        point = study.points[group.places[place]]
        units = {key: axis_unit(key, [point]) for key in point.axes}
        words = point_words(point, units)
        parts.append(f"{word} in run {point.number}{f' ({words})' if words else ''}")
    return ", ".join(parts)
