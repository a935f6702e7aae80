"""Check of what is shown of runs, kinds of plots and sections of reports: it can be made and drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from typing import Any

from mbdkit.archive.run import Run
from mbdkit.plugin.reports import report_charts, report_sections
from mbdkit_report import Figure, Section, draw_chart, mechanism_of, run_report
from mbdkit_testing.check import Skip, check
from mbdkit_testing.check_result import Result, failed, passed
from mbdkit_testing.item_checks import EXAMPLES, ItemUnderTest, short_runs


@check("contract.pages")
def pages(under_test: ItemUnderTest[Any]) -> Result:
    """For short runs of packaged examples, it makes sections and figures that a page can show."""
    from matplotlib.figure import Figure as Canvas

    count = 0
    for name, run in short_runs():
        shown = list(_shown(under_test.plugin, run))
        if wrong := [type(one).__name__ for one in shown if not isinstance(one, Figure | Section)]:
            return failed(f"for a run of {name} it returned an object of type {wrong[0]}, not a Figure or Section")
        figures = tuple(one for one in shown if isinstance(one, Figure))
        page = run_report(run)
        sections = tuple(one for one in shown if isinstance(one, Section))
        page = replace(page, sections=sections, verdict=replace(page.verdict, figures=figures))
        page.html()
        for figure in figures:
            draw_chart(Canvas().subplots(), figure)
        count += len(shown)
    if not count:
        raise Skip(f"it shows nothing of the packaged examples {', '.join(EXAMPLES)}")
    return passed(shown=count)


def _shown(item: Any, run: Run) -> Iterator[object]:
    if item.kind == "plot-kind":
        module = import_module(item.module)
        charts = list(module.charts(run))
        yield from charts
        if charts:
            yield module.chart(run)
    else:
        yield from report_sections.of(item.make)(run, mechanism_of(run))
        if item.charts is not None:
            yield from report_charts.of(item.charts)(run)


CHECKS = (pages,)
