"""Sections that the report of every run may have, in the form of `mbdkit.plugin.ReportSection`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbdkit_report.figures.page_model import Section
from mbdkit_report.pages.answer_section import answer_section, beam_section, gradient_section

if TYPE_CHECKING:
    from mbdkit.archive.run import Run
    from mbdkit.mechanism.mechanism import Mechanism


def standard_sections(run: Run, mechanism: Mechanism | None) -> list[Section]:
    """Return the sections on the largest forces, on beams and on gradients, as far as the run has them."""
    sections = (answer_section(run), beam_section(run, mechanism), gradient_section(run))
    return [section for section in sections if section is not None]
