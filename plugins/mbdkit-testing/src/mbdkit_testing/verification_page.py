"""Verification reports as a self-contained HTML page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import mbdkit
from mbdkit.base.files import check_output, check_suffix, replacing
from mbdkit.spec.yaml_reader import write_yaml
from mbdkit_report import render
from mbdkit_testing.check_result import Report, figures_text

_TONES = {"pass": "yes", "fail": "no", "warn": "partly", "not claimed": "open", "skip": "open"}


def html(reports: Sequence[Report]) -> str:
    """Return the page of one or several reports."""
    title = f"Verification of {', '.join(report.id for report in reports)}"
    filters: dict[str, Callable[..., object]] = {
        "tone": _TONES.__getitem__,
        "figures": figures_text,
        "claimed": _claimed,
    }
    return render("verification.html", {"title": title, "version": mbdkit.__version__, "reports": reports}, filters)


def check_page(target: Path, *, overwrite: bool) -> None:
    """Raise SpecError if a page cannot be written."""
    check_suffix(target, (".html", ".htm"), "a verification")
    check_output(target, overwrite=overwrite)


def write_page(reports: Sequence[Report], target: Path, *, overwrite: bool) -> None:
    """Write the page of one or several reports."""
    page = html(reports)
    with replacing(target, overwrite=overwrite) as temporary:
        temporary.write_text(page, encoding="utf-8", newline="\n")


def _claimed(report: Report) -> str:
    plain = {key: list(value) if isinstance(value, tuple) else value for key, value in report.claims.items()}
    return write_yaml({"options": report.options, "claims": plain})
