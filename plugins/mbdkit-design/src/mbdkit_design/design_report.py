"""The report of a design: the mechanism at the start and at the best point, its loads, and whether the gain exceeds the
errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbdkit.base.terminal import say
from mbdkit.base.text import listed
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_biomech.inverse_dynamics.loads.load_frames import load_drawing
from mbdkit_design.design import Design
from mbdkit_design.design_charts import (
    POINT_WORDS,
    Pair,
    front_charts,
    landscape_charts,
    load_charts,
    sensitivity_section,
    table_charts,
)
from mbdkit_design.design_spec import GOAL, DesignSpec
from mbdkit_design.design_verdict import costs_table, design_verdict, robustness_table
from mbdkit_design.evaluation import Evaluator
from mbdkit_design.gains import Cost, costs, goal_units, goal_words, measure_units, variable_unit
from mbdkit_design.landscape import Cut, Sensitivity, cuts, sensitivities
from mbdkit_design.robustness import robustness
from mbdkit_design.solve_design import WORKER, evaluating
from mbdkit_design.stages import Stages
from mbdkit_design.store import WHICH, DesignFolder, runs_of
from mbdkit_design.trust import QUESTIONED
from mbdkit_report import (
    TONES,
    Illustration,
    NamedPose,
    ReportPage,
    Section,
    Table,
    drawing,
    environment,
    film_of,
    glance,
    key_words,
    mechanism_of,
    methods,
    with_unit,
)
from mbdkit_report.seams import report_of_folder
from mbdkit_studies import Engine

_NUMBERS = 60_000  #: Approximate number of pose values in each animation.
COSTS = 2  #: Largest number of loads in the headline. Only loads that the design increases are shown.


@report_of_folder
@contextmanager
def design_report(path: Path, workers: int = 1) -> Iterator[ReportPage]:
    """Context manager that provides the report of a design with a result. The archives of its runs are open within the
    context. The report includes points around the best point, which are evaluated first.

    Parameters
    ----------
    workers
        Number of processes that evaluate the points.
    """
    folder = DesignFolder(path)
    design = folder.read()
    with ExitStack() as stack:
        pairs = stack.enter_context(runs_of(design, path))
        with (
            folder.locked(),
            evaluating(design.spec, folder, Engine(workers, None, WORKER), Stages(design.spec, say)) as evaluator,
        ):
            best = evaluator.point(design.best.variables)
            around = {"": cuts(evaluator, best)} | {
                comparison.name: cuts(Evaluator(design.spec, evaluator.run, compared=comparison.name), best)
                for comparison in design.compared
                if comparison.believed
            }
            changes = sensitivities(evaluator, best)
            elsewhere = costs(pairs)
            tables = costs_table(elsewhere), robustness_table(design.spec, design.best, robustness(evaluator, best))
        yield _page(design, path, pairs, around, changes, elsewhere, tables)


def _page(
    design: Design,
    path: Path,
    pairs: Mapping[str, Pair],
    around: Mapping[str, Sequence[Cut]],
    changes: Sequence[Sensitivity],
    elsewhere: Sequence[Cost],
    tables: Sequence[Table],
) -> ReportPage:
    first = next(iter(pairs.values()))["best"]
    document = design.spec._document
    data = {} if document is None else dict(document.data)
    units = goal_units(design.spec)
    words = {name: key_words(name) for name in design.spec.single}
    verdict = design_verdict(design)
    numbered = [f"table-{number}" for number, _ in enumerate(design.spec.tables, start=1)]
    figures = (
        *table_charts(design),
        *load_charts(design, pairs),
        *front_charts(design, units),
        *landscape_charts(design, around, units),
    )
    return ReportPage(
        title=design.spec.title or path.resolve().name,
        settings=f"{design.counted_runs} \u00b7 {design.spec.optimizer.name} \u00b7 {design.message}",
        headline=(
            ("verdict", design.trust.level),
            *((goal_words(gain.name), gain.text()) for gain in design.gains),
            *((key_words(name), text) for name, _, text in _points(design)),
            *(("it costs elsewhere", cost.text()) for cost in elsewhere[:COSTS] if cost.share > 0),
        ),
        tone=TONES.get(design.trust.level, ""),
        verdict=replace(verdict, figures=figures, tables=(*verdict.tables, *(table for table in tables if table.rows))),
        films=tuple(_films(pairs)),
        methods=methods([pair["best"].spec for pair in pairs.values()]),
        environment=environment(first.provenance, {"created (UTC)": first.created_utc}),
        reproduce="Save the spec below as design.yaml; it has all bases, but not the tables that these name.",
        commands="mbdkit design design.yaml --report",
        spec=write_yaml(data),
        spec_file="design.yaml",
        alarm=_alarm(design),
        glance=_glance(design, pairs),
        sections=(
            *_devices(design, pairs),
            *((sensitivity_section(changes, words, measure_units(design.spec)),) if words else ()),
        ),
        beside_verdict=("goals", *numbered, "variables", "compared", "costs", "robustness"),
    )


def _alarm(design: Design) -> str:
    """Return the warning at the top of the page; empty if there is none."""
    if not design.is_feasible:
        return "NO POINT SATISFIES ALL LIMITS"
    return design.doubt or (design.trust.judgement if design.trust.level in QUESTIONED else "")


def _devices(design: Design, pairs: Mapping[str, Pair]) -> Iterator[Section]:
    """Yield sections with drawings: the mechanism at the start, in the first scenario, and the forces at the best point
    in each scenario.
    """
    values = ", ".join(f"{key_words(name)} {text}" for name, text, _ in _points(design))
    yield Section("device-start", f"The device {POINT_WORDS['start']}", (f"With {values}.",), _drawn(pairs, "start"))
    for index, (scenario, runs) in enumerate(pairs.items()):
        if (frames := load_drawing(runs["best"], mechanism_of(runs["best"]))) is not None:
            where = f" in the scenario {scenario}" if scenario else ""
            yield Section(f"work-{index + 1}", f"The device at work{where}", (), frames)


def _drawn(pairs: Mapping[str, Pair], which: str) -> Illustration:
    """Return the drawing of the mechanism at one of the points, in the first scenario."""
    name, pair = next(iter(pairs.items()))
    run = pair[which]
    pose = np.asarray(run.array("trajectory/position")[0])
    shown = drawing(NamedPose.of(mechanism_of(run), list(run.bodies), pose, np.asarray(run.time)))
    where = f"{POINT_WORDS[which]}{f', scenario {name}' if name else ''}"
    return replace(shown, caption=f"{shown.caption} The device {where}.")


def _glance(design: Design, pairs: Mapping[str, Pair]) -> Section:
    spec = design.spec
    goals = listed([text if name == GOAL else f"{name} = {text}" for name, text in spec.goals.items()], "and")
    bounds = [f"{key_words(name)} from {_bounds(spec, name)}" for name in spec.variables]
    limits = f", within the limits of {listed(list(spec.subject_to), 'and')}" if spec.subject_to else ""
    asked = f"the least {goals}, by {listed(bounds, 'and')}{limits}"
    level = design.trust.level
    reason = design.trust.judgement.partition(": ")[2].removeprefix(f"{level}, ")
    return glance(asked, level, [*filter(None, [design.doubt]), reason], _drawn(pairs, "best"))


def _bounds(spec: DesignSpec, name: str) -> str:
    low, high = spec.variables[name].bounds
    return f"{low:.4g} to {with_unit(high, variable_unit(spec, name))}"


def _points(design: Design) -> Iterator[tuple[str, str, str]]:
    """Yield the variables by name, with their values at both points and their units as text."""
    for name, start, best in design.both_points("{:.6g}"):
        unit = variable_unit(design.spec, name)
        yield name, f"{start} {unit}".rstrip(), f"{best} {unit}".rstrip()


def _films(pairs: Mapping[str, Pair]) -> Iterator[dict[str, object]]:
    """Yield the animations of the runs at the best point and at the start."""
    for scenario, pair in pairs.items():
        for which in reversed(WHICH):
            yield film_of(pair[which], _NUMBERS, f"{scenario}, {which}" if scenario else which)
