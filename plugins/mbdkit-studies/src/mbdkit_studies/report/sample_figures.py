"""Charts and tables of a study with a random sample: distributions, sensitivities, and quantiles over time."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mbdkit.base.errors import MbdkitError
from mbdkit.measures.reductions import REDUCTIONS
from mbdkit_report import Axis, Cell, Column, Figure, Line, Table, key_words
from mbdkit_studies.report.study_figures import Quantity, asked_measures, is_wide, slug
from mbdkit_studies.statistics.sample_groups import SampleGroup, measured, sample_groups
from mbdkit_studies.statistics.sample_statistics import CONFIDENCE, statistics_of_group
from mbdkit_studies.statistics.sobol_indices import ROUND_OFF, Sensitivity
from mbdkit_studies.store.study_point import axis_unit
from mbdkit_studies.study import Study

_FEWEST = 8  #: A distribution is shown only if at least this number of values is known.
_MOST_BINS = 60
_MOST_DOTS = 2000
_MOST_GROUPS = 4
#: Largest number of variables in charts: those with the largest total Sobol indices or, without indices, with the
#: largest correlations.
_MOST_VARIABLES = 6
_BANDS = (0.05, 0.25, 0.5, 0.75, 0.95)
_RESAMPLES = 200  #: Number of bootstrap samples for each point in charts of convergence; tables use more.


@dataclass(frozen=True, eq=False)
class _Measured:
    """A measure of the runs of one sample. Its `values` are nan where a run is not complete."""

    study: Study
    group: SampleGroup
    quantity: Quantity
    values: np.ndarray

    @property
    def name(self) -> str:
        """Name of the column of the measure."""
        return self.quantity.columns[0]

    @property
    def axis(self) -> Axis:
        """Axis of the measure; logarithmic if the values cover about a decade or more."""
        return replace(self.quantity.axis, log=is_wide(self.values))

    def slug(self, *words: str) -> str:
        """Return a name for a chart of this measure, for use in file names."""
        return slug(*words, self.name, self.group.words)

    def sensitivity(self, members: int | None = None, **options: int) -> Sensitivity | None:
        """Return the Sobol indices from the first `members` of the sample, by default from all; None if the sample does
        not determine them.
        """
        if (sample := self.study.spec.sample) is None or sample.design != "saltelli":
            return None
        try:
            return self.study.sensitivity(self.name, where=self.group.where or None, members=members, **options)
        except MbdkitError:  # too few members have a value
            return None


def _told(group: SampleGroup) -> str:
    """Return a sentence that says which runs belong to a sample; empty in a study with a single sample."""
    return f" Runs with: {group.words}." if group.words else ""


def sample_figures(study: Study) -> tuple[Figure, ...]:
    """Return the charts of a study with a sample.

    For each measure, they are a histogram, charts of the convergence of the Sobol indices, and charts against the
    variables. Charts of quantiles over time follow, for the quantities in the measures that the study stores.
    """
    figures: list[Figure] = []
    for measure in _measures(study):
        figures += [_histogram(measure), *_convergence(measure), *_scatters(measure)]
    for group in sample_groups(study)[:_MOST_GROUPS]:
        figures += _bands(study, group)
    return tuple(figures)


def sample_tables(study: Study) -> tuple[Table, ...]:
    """Return the tables of Sobol indices, if the sample determines them, and of quantiles of the measures."""
    several = len(sample_groups(study)) > 1
    indices: list[tuple[Cell, ...]] = []
    spreads: list[tuple[Cell, ...]] = []
    notes: dict[str, None] = {}
    for measure in _measures(study):
        runs: tuple[Cell, ...] = (measure.group.words,) if several else ()
        group = statistics_of_group(study, measure.group, measure.name)
        assert group is not None  # `_measures` yields only measures with enough values
        numbers = (group.mean, group.std, *group.quantiles.values())
        least, most = float(np.nanmin(measure.values)), float(np.nanmax(measure.values))
        cells: tuple[Cell, ...] = (group.runs, *(number.text() for number in numbers), least, most)
        spreads.append((*runs, measure.quantity.axis.label, measure.quantity.axis.unit, *cells))
        if (sobol := measure.sensitivity()) is not None:
            how = (
                f"Estimates of Saltelli et al. (2010), table 2, (b) and (f), from {sobol.members} members, with "
                f"{100 * sobol.confidence:g} % intervals by the bootstrap. First order: share of the variance "
                f"explained by a variable alone; total: including its interactions with the others."
            )
            notes |= dict.fromkeys(filter(None, (how, sobol.reason, sobol.note)))
            for index, key in enumerate(sobol.variables):
                ends = (column[index] for both in sobol.indices.with_intervals for column in both)
                shares = [float(f"{end:.3g}") for end in ends]
                indices.append((*runs, measure.quantity.axis.label, key_words(key), *shares))
    first = (Column("runs"),) if several else ()
    tables = []
    if indices:
        shown = map(Column, ("measure", "variable", "first order", "from", "to", "total", "from", "to"))
        note = " ".join(notes)
        tables.append(Table("sobol", "Sobol indices", (*first, *shown), tuple(indices), note, headline=True))
    if spreads:
        shown = map(Column, ("measure", "unit", "values", "mean", "standard deviation", "5 %", "median", "95 %"))
        columns = (*first, *shown, Column("smallest"), Column("largest"))
        note = f"With {100 * CONFIDENCE:g} % intervals. Runs that failed or are rated bad are left out."
        tables.append(Table("spread", "Distributions of the measures", columns, tuple(spreads), note))
    return tuple(tables)


def _measures(study: Study) -> Iterator[_Measured]:
    """Yield the measures of each sample whose values differ between the runs and are known for at least `_FEWEST` runs.
    Measures that the study defines come first.
    """
    defined = {measure.name for measure in study.spec.defined_measures()}
    quantities = sorted(asked_measures(study), key=lambda quantity: quantity.columns[0] not in defined)
    for group in sample_groups(study)[:_MOST_GROUPS]:
        for quantity in quantities:
            try:
                values = measured(study, quantity.columns[0], group.places)
            except MbdkitError:  # an error against a reference run, which samples do not have
                continue
            known = values[np.isfinite(values)]
            if len(known) >= _FEWEST and np.ptp(known) > ROUND_OFF * np.max(np.abs(known)):
                yield _Measured(study, group, quantity, values)


def _histogram(one: _Measured) -> Figure:
    known = one.values[np.isfinite(one.values)]
    axis = one.axis
    bins = min(_MOST_BINS, max(5, round(len(known) ** 0.5)))
    ends = float(known.min()), float(known.max())
    edges = np.geomspace(*ends, bins + 1) if axis.log else np.linspace(*ends, bins + 1)
    edges[[0, -1]] = ends  # geomspace rounds its ends
    counts, _ = np.histogram(known, edges)
    x, y = np.repeat(edges, 2), np.concatenate([[0], np.repeat(counts, 2), [0]]).astype(float)
    line = Line("runs", x, y, "line", band=np.stack([x, y], axis=1))
    caption = f"{one.quantity.caption} {len(known)} runs in {bins} classes of equal width.{_told(one.group)}"
    if axis.log:
        caption = caption.replace("equal width", "equal width on the logarithmic axis")
    title = f"{one.quantity.title}: histogram of the runs"
    return Figure(one.slug("histogram"), title, caption, axis, Axis("runs"), (line,))


def _scatters(one: _Measured) -> Iterator[Figure]:
    """Yield charts of a measure against each of the most influential variables, with one point per run."""
    table = one.study.grid(one.group.family).table
    known = np.flatnonzero(np.isfinite(one.values))
    keys = [key for key, column in table.items() if column.dtype.kind in "fi" and np.ptp(column[known]) > 0]
    if (sobol := one.sensitivity(resamples=1)) is not None:
        weight = dict(zip(sobol.variables, np.nan_to_num(sobol.total), strict=True))
    else:
        weight = {key: abs(float(np.corrcoef(table[key][known], one.values[known])[0, 1])) for key in keys}
    chosen = sorted(keys, key=lambda key: -weight[key])[:_MOST_VARIABLES]
    dots = known[np.linspace(0, len(known) - 1, min(len(known), _MOST_DOTS)).astype(int)]
    some = f" {len(dots)} of {len(known)} runs." if len(dots) < len(known) else ""
    for key in chosen:
        axis = Axis(key_words(key), axis_unit(key, one.study.points[:1]), _is_logarithmic(one.study, key))
        line = Line(one.quantity.title, table[key][dots].astype(float), one.values[dots], "points")
        title = f"{one.quantity.title} against {axis.label}"
        caption = f"{one.quantity.caption}{some}{_told(one.group)}"
        yield Figure(one.slug("over", key), title, caption, axis, one.axis, (line,))


def _is_logarithmic(study: Study, key: str) -> bool:
    """Return whether the axis of a variable is logarithmic, because its distribution is."""
    sample = study.spec.sample
    variable = {} if sample is None else sample.variables.get(key, {})
    return next(iter(variable), "").startswith(("log", "reciprocal"))


def _convergence(one: _Measured) -> list[Figure]:
    """Return charts of the Sobol indices against the number of members of the sample."""
    sample = one.study.spec.sample
    whole = one.sensitivity(resamples=1)
    if sample is None or whole is None or sample.n < 2 * _FEWEST:
        return []
    numbers = [count for count in 2 ** np.arange(4, 21) if count < sample.n] + [sample.n]
    results = [(count, one.sensitivity(int(count), resamples=_RESAMPLES)) for count in numbers]
    known = [(count, sobol.indices) for count, sobol in results if sobol is not None]
    chosen = np.argsort(-np.nan_to_num(whole.total), kind="stable")[:_MOST_VARIABLES]
    x = np.array([count for count, _ in known], float)
    figures = []
    for kind, words in (("first", "First-order indices"), ("total", "Total indices")):
        lines = []
        for place in chosen:
            low, middle, high = (
                np.array([getattr(indices, f"{kind}{end}")[place] for _, indices in known])
                for end in ("_low", "", "_high")
            )
            band = np.concatenate([np.stack([x, low], axis=1), np.stack([x, high], axis=1)[::-1]])
            lines.append(Line(key_words(whole.variables[place]), x, middle, "both", band=band))
        title = f"{words} of {one.quantity.axis.label} against the members of the sample"
        caption = "Sobol indices from the first members of the sample, with 95 % intervals by the bootstrap."
        axes = Axis("members of the sample", log=True), Axis("share of the variance")
        figures.append(Figure(one.slug("sobol", kind), title, caption + _told(one.group), *axes, tuple(lines)))
    return figures


def _bands(study: Study, group: SampleGroup) -> Iterator[Figure]:
    """Yield for each quantity in the measures a chart of its quantiles over time."""
    for text in _quantities(study):
        try:
            bands = study.quantiles(text, _BANDS, where=group.where or None)
        except MbdkitError:  # the quantity is not stored, has parameters, or is a vector
            continue
        lowest, low, middle, high, highest = bands.values
        x = bands.time
        known = np.isfinite(middle)
        edge = [np.stack([x, y], axis=1)[known] for y in (low, high)]
        gap = [np.nan]
        lines = (
            Line("median, with the range from 25 % to 75 %", x, middle, band=np.concatenate([edge[0], edge[1][::-1]])),
            Line("5 % and 95 %", np.concatenate([x, gap, x]), np.concatenate([lowest, gap, highest])),
        )
        unit = "" if bands.unit == "1" else bands.unit
        caption = f"Quantiles of {int(bands.count.max())} runs at each time.{bands.told}{_told(group)}"
        name = slug("quantiles", text, group.words)
        yield Figure(name, f"{text} over time", caption, Axis("time", "s"), Axis(text, unit), lines)


def _quantities(study: Study) -> list[str]:
    """Return the quantities over time from which the measures of a study are computed; if there are none, the angle of
    the last body.
    """
    results: dict[str, None] = {}
    for measure in study.spec.defined_measures():
        try:
            tree = ast.parse(measure.expression, mode="eval")
        except SyntaxError:  # a name in the expression is not a Python name
            continue
        for node in ast.walk(tree):
            match node:
                case ast.Call(func=ast.Name(id=name), args=[argument]) if name in REDUCTIONS:
                    results[ast.get_source_segment(measure.expression, argument) or ""] = None
    if not results:
        try:
            return [f"{list(study.points[0].spec.mechanism().bodies)[-1]}.angle"]
        except (MbdkitError, IndexError):
            return []
    return list(results)
