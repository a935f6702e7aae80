"""A verdict as text for the terminal, as JSON values and as Markdown."""

from __future__ import annotations

from collections.abc import Callable

from markupsafe import Markup

from mbdkit.base.text import shown
from mbdkit.base.text import table as aligned
from mbdkit_report.analysis.verdict import Verdict
from mbdkit_report.figures.page_model import Table
from mbdkit_report.pages.report_page import ReportPage, cell_text
from mbdkit_report.pages.templating import render

_MARKED = str.maketrans({char: f"\\{char}" for char in "\\`*_[]|#~$"} | {"<": "&lt;", ">": "&gt;", "&": "&amp;"})


def headlines(verdict: Verdict) -> tuple[Table, ...]:
    """Return the tables of a verdict that contain its headline numbers."""
    return tuple(table for table in verdict.tables if table.headline)


def terminal_text(verdict: Verdict) -> str:
    """Return claims and headline tables as text for the terminal; empty if there is no headline table."""
    if not (shown := headlines(verdict)):
        return ""
    claims = [f"{claim.answer!s:<6} {claim.statement} Found: {claim.computed}." for claim in verdict.claims]
    return "\n".join([*map(table_text, shown), *claims])


def table_text(table: Table) -> str:
    """Return a table with its title and note as text for the terminal."""
    return "\n".join(filter(None, [table.title, aligned(_cells(table), "  "), table.note]))


def json_values(verdict: Verdict) -> dict[str, object]:
    """Return the sentence, the claims and the headline tables of a verdict as JSON values; {} if it has no headline
    table.
    """
    if not (shown := headlines(verdict)):
        return {}
    values = verdict.to_dict()
    names = [table.name for table in shown]
    tables = [table for table in values["tables"] if table["name"] in names]
    return {"sentence": values["sentence"], "claims": values["claims"], "tables": tables}


def markdown_text(document: ReportPage) -> str:
    """Return a report as Markdown: its heading and sections, the verdict with its claims and notes, and the headline
    tables. Without headline tables all tables of the verdict are included.
    """
    tables = headlines(document.verdict) or document.verdict.tables
    filters: dict[str, Callable[..., object]] = {"markdown": lambda text: Markup(markdown(text)), "cells": _cells}
    return render("markdown.txt", {"page": document, "tables": tables}, filters)


def _cells(table: Table) -> list[list[str]]:
    heading = [f"{column.label} [{column.unit}]" if column.unit else column.label for column in table.columns]
    return [heading, *([cell_text(cell) for cell in row] for row in table.rows)]


def markdown(text: str) -> str:
    """Return text from files as one line of Markdown in which all special characters are escaped."""
    words = " ".join(shown(part) for part in text.split())
    start = "\\" if words[:1] in ("-", "+", "=") and not _is_number(words) else ""
    return start + words.translate(_MARKED)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
