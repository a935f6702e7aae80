"""The sections that plugins and this package add to the report of a run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

from mbdkit.archive.run import Run
from mbdkit.mechanism.mechanism import Mechanism
from mbdkit.registry.catalogue import Registered
from mbdkit.registry.feature_items import ReportSection
from mbdkit.registry.manager import registry, use
from mbdkit_report.figures.page_model import Figure, Section
from mbdkit_report.seams import film_data, report_charts, report_sections


def _items() -> Iterator[tuple[Registered, ReportSection]]:
    yield from ((item, cast(ReportSection, item.plugin)) for item in registry().of_kind("report-section"))


def added_sections(run: Run, mechanism: Mechanism | None) -> list[Section]:
    """Return the sections of plugins and of this package."""
    return [
        use(item, lambda section=section: section, of=Section)  # type: ignore[misc]
        for item, own in _items()
        for section in use(item, lambda own=own: list(report_sections.of(own.make)(run, mechanism)))  # type: ignore[misc]
    ]


def added_charts(run: Run) -> list[Figure]:
    """Return the charts that come with the sections."""
    return [
        use(item, lambda chart=chart: chart, of=Figure)  # type: ignore[misc]
        for item, own in _items()
        if own.charts is not None
        for chart in use(item, lambda charts=own.charts: list(report_charts.of(charts)(run)))  # type: ignore[misc]
    ]


def with_additions(run: Run, film: dict[str, object]) -> dict[str, object]:
    """Return the data of the player with what plugins add to them."""
    for item, own in _items():
        if own.film is not None:
            film = use(item, lambda add=own.film, film=film: film_data.of(add)(run, film), of=dict)  # type: ignore[misc]
    return film
