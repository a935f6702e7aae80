"""The sections that plugins and this package add to the report of a run."""

from __future__ import annotations

from typing import cast

from mbdkit.registry.feature_items import ReportSection
from mbdkit.registry.manager import registry


def report_sections() -> list[ReportSection]:
    """Return the sections of the report of a run that plugins and this package offer, in their order."""
    return [cast(ReportSection, item.plugin) for item in registry().of_kind("report-section")]
