"""The report of a design: the device at the start and at the best point, its loads, and how far to trust it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbdkit.analysis.verdict import Answer, Axis, Cell, Claim, Column, Figure, Line, Mark, Table, Verdict
from mbdkit.archive.reader import load
from mbdkit.designs.evaluation import Evaluator
from mbdkit.designs.landscape import Cut, cuts
from mbdkit.designs.store import PAGE, archive_name
from mbdkit.events.event_expression import Quantity
from mbdkit.files import replacing
from mbdkit.measures.measure_expression import MeasureExpression
from mbdkit.measures.measured_quantities import is_over_time, is_vector, recorded, unit_of
from mbdkit.plot.downsampling import bands
from mbdkit.report.mechanism_drawing import NamedPose
from mbdkit.report.methods_used import methods
from mbdkit.report.model_section import drawing
from mbdkit.report.report_page import ReportPage
from mbdkit.report.run_report import environment, mechanism_of
from mbdkit.report.section import Section
from mbdkit.spec import InverseSpec, RunSpec
from mbdkit.spec.design_spec import variable_path
from mbdkit.spec.key_words import key_unit, key_words
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit.text import counted

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.designs.design import Design, DesignPoint

_POINTS = 1_000
_WORDS = {"start": "at the start", "best": "at the best point"}
_TIME = Axis("time", "s")

Pair = dict[str, "Run"]
"""The runs of a scenario at the ``start`` and at the ``best`` point."""


def write_design_report(design: Design, folder: Path, *, overwrite: bool) -> Path:
    """Write the report of a design into its folder, which has the archives, and return its file.

    Parameters
    ----------
    overwrite
        Whether an existing page may be replaced.
    """
    page = folder / PAGE
    with ExitStack() as stack:
        pairs = {
            name: {which: stack.enter_context(load(folder / archive_name(which, name))) for which in _WORDS}
            for name in design.spec.specs
        }
        text = _page(design, pairs, folder).html()
    with replacing(page, overwrite=overwrite) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return page


def _page(design: Design, pairs: dict[str, Pair], folder: Path) -> ReportPage:
    first = next(iter(pairs.values()))["best"]
    document = design.spec._document
    data = {} if document is None else dict(document.data)
    evaluator = Evaluator(design.spec)
    around = cuts(evaluator, evaluator.point(design.best.variables))
    return ReportPage(
        title=design.spec.title or folder.resolve().name,
        settings=f"{counted(design.runs, 'run')} \u00b7 {design.spec.optimizer.name} \u00b7 {design.message}",
        verdict=replace(
            _verdict(design), figures=(*_loads(design, pairs), *_front(design), *_landscape(design, around))
        ),
        methods=methods([pair["best"].spec for pair in pairs.values()]),
        environment=environment(first.provenance, {"created (UTC)": first.created_utc}),
        reproduce="Save the spec below as design.yaml, beside the files that it names.",
        commands="mbdkit design design.yaml --report",
        spec=write_yaml(data),
        spec_file="design.yaml",
        alarm="" if design.is_feasible else "NO POINT SATISFIES ALL LIMITS",
        sections=tuple(_devices(design, pairs)),
        beside_verdict=("goals", "variables", "forces"),
    )


def _devices(design: Design, pairs: dict[str, Pair]) -> Iterator[Section]:
    """Yield the sections with the device at the start and at the best point, in the first scenario."""
    name, pair = next(iter(pairs.items()))
    for which, run in pair.items():
        pose = np.asarray(run.array("trajectory/position")[0])
        shown = drawing(NamedPose.of(mechanism_of(run), list(run.bodies), pose, np.asarray(run.time)))
        where = f" Scenario: {name}." if name else ""
        point: DesignPoint = getattr(design, which)
        values = ", ".join(f"{key_words(key)} {value:.6g}" for key, value in point.variables.items())
        sentence = f"{values[:1].upper()}{values[1:]}."
        yield Section(
            f"device-{which}", f"The device {_WORDS[which]}", (sentence,), replace(shown, caption=shown.caption + where)
        )


def _verdict(design: Design) -> Verdict:
    claims = [*_gains(design), _certified(design)]
    if design.spec.subject_to:
        answer = Answer.YES if design.is_feasible else Answer.NO
        told = f"{counted(len(design.spec.subject_to), 'limit')} in {counted(len(design.spec.specs), 'scenario')}"
        claims.append(Claim("limits", "The best point satisfies all limits.", "", told, answer, ""))
    at_best, every = design.searches
    note = f"{at_best} of {every} searches ended at this point to 0.1 % of the goal."
    alone = " A single search finds a local minimum; `optimizer.starts` makes several." if every == 1 else ""
    return Verdict(
        name="design",
        title="Verdict",
        sentence=" ".join([*(claim.sentence for claim in claims if claim.sentence), *design.warnings]),
        claims=tuple(claims),
        tables=tuple(_tables(design)),
        notes=(note + alone,),
    )


def _gains(design: Design) -> Iterator[Claim]:
    """Yield a claim for each goal: that it gains more than the estimated errors."""
    for name, best in design.best.goals.items():
        before, error = design.start.goals[name], design.trust.errors[name]
        share = f" ({100 * (best - before) / abs(before):+.3g} %)" if before else ""
        sentence = f"The {_goal_words(name)} changes from {before:.6g} to {best:.6g}{share}."
        known = "of unknown error" if np.isnan(error) else f"with an estimated error of {error:.1g}"
        answer = Answer.OPEN if np.isnan(error) else Answer.YES if design.trust.is_gain[name] else Answer.NO
        statement = f"The gain of the {_goal_words(name)} exceeds the errors of both points."
        yield Claim(f"gain-{name}", statement, "", f"{before:.6g} to {best:.6g}, {known}", answer, sentence)


def _certified(design: Design) -> Claim:
    level = design.trust.verdict
    answer = {"good": Answer.YES, "unknown": Answer.OPEN, "doubtful": Answer.PARTLY}.get(level, Answer.NO)
    return Claim("runs", "The runs at the best point can be trusted.", "", f"worst verdict: {level}", answer, "")


def _goal_words(name: str) -> str:
    return "goal" if name == "goal" else f"goal {name}"


def _tables(design: Design) -> Iterator[Table]:
    """Yield the tables of variables, and of goals and limits in each scenario."""
    rows: list[tuple[Cell, ...]] = [
        (key_words(name), one.bounds[0], design.start.variables[name], design.best.variables[name], one.bounds[1],
         _unit(design, name), _at_bound(design, name))
        for name, one in design.spec.variables.items()
    ]  # fmt: skip
    columns = [
        Column(label) for label in ("variable", "lower bound", "start", "best", "upper bound", "unit", "at a bound")
    ]
    yield Table("variables", "Variables", tuple(columns), tuple(rows))
    found: list[tuple[Cell, ...]] = []
    for scenario, measures in design.best.measures.items():
        for name, value in measures.items():
            limit = design.spec.subject_to.get(name)
            found.append(
                (scenario, name, design.start.measures[scenario][name], value,
                 None if limit is None else limit.min, None if limit is None else limit.max)
            )  # fmt: skip
    headings = [Column(label) for label in ("scenario", "goal or limit", "start", "best", "smallest", "largest")]
    if not design.spec.scenarios:
        headings, found = headings[1:], [row[1:] for row in found]
    yield Table("goals", "Goals and limits", tuple(headings), tuple(found), _expressions(design))


def _expressions(design: Design) -> str:
    told = [f"{one.name}: {one.expression}" for one in design.spec.defined_measures()]
    return "; ".join(told)


def _at_bound(design: Design, name: str) -> str:
    low, high = design.spec.variables[name].bounds
    best, slack = design.best.variables[name], 1e-6 * (high - low)
    return "lower" if best <= low + slack else "upper" if best >= high - slack else ""


def _unit(design: Design, name: str) -> str:
    return key_unit(variable_path(name), design.spec.specs.values())


def _loads(design: Design, pairs: dict[str, Pair]) -> Iterator[Figure]:
    """Yield a chart over time of each quantity in goals and limits, before and after."""
    for number, (scenario, pair) in enumerate(pairs.items()):
        spec = design.spec.specs[scenario]
        for place, quantity in enumerate(_quantities(design, spec)):
            lines = tuple(_line(which, quantity, run) for which, run in pair.items())
            words = ".".join(filter(None, (quantity.kind, quantity.name, quantity.attribute)))
            where = f" ({scenario})" if scenario else ""
            shaded = " Shaded: estimated error." if any(line.band is not None for line in lines) else ""
            yield Figure(
                f"load-{number + 1}-{place + 1}", f"{words}{where}", f"Before and after the design.{shaded}",
                _TIME, Axis(quantity.attribute.replace("_", " "), str(unit_of(quantity, spec))), lines,
            )  # fmt: skip


def _quantities(design: Design, spec: RunSpec | InverseSpec) -> Sequence[Quantity]:
    """Return the quantities in goals and limits that change over time."""
    found: dict[Quantity, None] = {}
    for one in design.spec.defined_measures():
        parsed = MeasureExpression.parse(one.expression, spec, one.unit)
        found |= dict.fromkeys(quantity for quantity in parsed.quantities if is_over_time(quantity))
    return list(found)


def _line(which: str, quantity: Quantity, run: Run) -> Line:
    values = recorded(quantity, run)
    if is_vector(quantity):
        values = np.hypot(*values)
    time = np.asarray(run.time)
    band = None
    if (quantity.kind, quantity.attribute) == ("actuators", "value"):
        error = np.asarray(run.actuators[quantity.name].value_error)
        known = np.isfinite(error)
        if np.any(known):
            low, high = (np.column_stack([time, values + side * error])[known] for side in (-1, 1))
            band = np.concatenate([low, high[::-1]])
    x, y = bands(time, values[:, None], points=_POINTS).curve(0)
    return Line(_WORDS[which], x, y, band=band)


def _front(design: Design) -> Iterator[Figure]:
    """Yield the chart of the Pareto front of a design with two goals."""
    if len(design.best.goals) < 2:
        return
    first, second = design.best.goals
    points = {"front": design.front, "best": (design.best,), "start": (design.start,)}
    lines = tuple(
        Line(label, np.array([one.goals[first] for one in found]), np.array([one.goals[second] for one in found]),
             "both" if label == "front" else "points")
        for label, found in points.items()
    )  # fmt: skip
    caption = "Pareto front: no point has less of both goals. The best point is nearest to the least values of both."
    yield Figure("front", f"{second} against {first}", caption, Axis(first), Axis(second), lines)


def _landscape(design: Design, around: Sequence[Cut]) -> Iterator[Figure]:
    """Yield a chart of the goals along each variable."""
    for place, cut in enumerate(around):
        words, unit = key_words(cut.variable), _unit(design, cut.variable)
        goals = list(design.spec.totals)
        lines = tuple(Line(_goal_words(name), cut.values, cut.goals[:, k]) for k, name in enumerate(goals))
        yield Figure(
            f"cut-{place + 1}", f"Goal along {words}",
            "The goal near the best point, which is marked, with all other variables at their best values."
            + (" Limits are not considered: the goal may fall beyond an active one." if design.spec.subject_to else ""),
            Axis(words, unit), Axis("goal"), lines, marks=(Mark("best", design.best.variables[cut.variable]),),
        )  # fmt: skip
