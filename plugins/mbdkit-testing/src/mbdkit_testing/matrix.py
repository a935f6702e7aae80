"""The matrix of plugins: what was observed of each of them, from recorded evidence, as a page, CSV and JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mbdkit
from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import SpecError
from mbdkit.base.files import check_output, replacing
from mbdkit.base.plain_data import json_text
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import KINDS, Kind, Registered
from mbdkit.registry.manager import registry
from mbdkit.runs.method_evidence import evidence_of, read_records
from mbdkit_report import render
from mbdkit_testing.kit import verify
from mbdkit_testing.recorded_evidence import KINDS as KINDS_IN_MATRIX
from mbdkit_testing.recorded_evidence import options_of, record_of, records_of

#: Columns of integrators with a figure: heading, check, and names of its figures, of which the first known one counts.
FIGURES: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    *((f"order: {name.replace('-', ' ')}", f"order.{name}", ("measured",))
      for name in ("forced-pendulum", "driven-pendulum", "four-bar", "beam", "multipliers")),
    ("orders by formulation", "order.formulations", ()),
    ("order of dense output", "order.dense-output", ("measured",)),
    ("order of error estimate", "tolerance.error-estimate", ("measured",)),
    ("drift of positions: rate", "drift.position", ("rate", "drift")),
    ("of velocities", "drift.velocity", ("rate", "drift")),
    ("energy trend [J/s]", "geometry.energy", ("trend_J_per_s",)),
    ("with joints [J/s]", "geometry.energy-jointed", ("trend_J_per_s",)),
    ("change of momentum", "geometry.conserved-angular-momentum", ("change",)),
    ("there and back", "geometry.reversibility-pendulum", ("defect",)),
)  # fmt: skip
#: Claims of integrators that say what they support; their columns are empty where nothing is claimed.
CLAIMS = ("formulations", "stabilizations", "states", "mechanisms", "dense_order")
_TONES = {"fail": "no", "warn": "partly"}
_FILES = ("matrix.html", "matrix.csv", "matrix.json")


@dataclass(frozen=True)
class Row:
    """A plugin with certain options.

    `id`, `kind`, `status`: its id and kind, and what is known of its verification. `record`: results of the checks;
    empty if there are none. `broken`: what does not hold any more, as sentences.
    """

    id: str
    kind: Kind
    status: str
    record: Mapping[str, Any] = field(default_factory=dict)
    broken: Sequence[str] = ()

    @property
    def options(self) -> str:
        """The options, in one line."""
        return ", ".join(f"{key} {value}" for key, value in self.record.get("options", {}).items())

    @property
    def checks(self) -> Mapping[str, Mapping[str, Any]]:
        """Outcome, cause and figures of each check."""
        known: Mapping[str, Mapping[str, Any]] = self.record.get("checks", {})
        return known

    def cells(self) -> dict[str, tuple[str, str]]:
        """Return text and name of the check of each cell, empty if there is none, by the heading of its column."""
        claims, check = self.record.get("claims", {}), "order.forced-pendulum"
        cells = {"order claimed": (str(claims.get("order", "")), check if check in self.checks else "")}
        for name in CLAIMS if self.kind == "integrator" and claims else ():
            value = claims.get(name, "")
            text = listed(value, "and") if isinstance(value, list) else "yes" if value is True else str(value)
            cells[name.replace("_", " ")] = text, ""
        for heading, check, names in FIGURES if self.kind == "integrator" else ():
            figures = self.checks.get(check, {}).get("figures", {})
            known = [str(figures[name]) for name in names if name in figures]
            text = known[0] if known else "; ".join(f"{name} {value}" for name, value in figures.items() if not names)
            # errors may follow no power of the step
            cells[heading] = text or "fails" * (self.checks.get(check, {}).get("outcome") == "fail"), check
        for group in dict.fromkeys(name.partition(".")[0] for name in self.checks):
            own = {name: entry["outcome"] for name, entry in self.checks.items() if name.startswith(f"{group}.")}
            worst = [name for name, outcome in own.items() if outcome == "fail"]
            text = f"fail: {listed(name.partition('.')[2] for name in worst)}" if worst else f"{len(own)} checked"
            cells[group] = text, (worst or list(own))[0]
        return cells

    def tone(self, check: str) -> str:
        """Return the class of a cell."""
        return _TONES.get(self.checks.get(check, {}).get("outcome", ""), "")


def recorded_rows(further: Iterable[Row] = ()) -> list[Row]:
    """Return a row for each record of the installed plugins, and for those without; `further` rows replace those of the
    same plugins.
    """
    rows: dict[str, list[Row]] = {}
    for row in further:
        rows.setdefault(f"{row.kind} {row.id}", []).append(row)
    for item in registry().items:
        if item.kind in KINDS_IN_MATRIX and (item.origin.distribution != MBDKIT or item.kind == "integrator"):
            records = records_of(item) or [{}]
            status = str(evidence_of(item))
            rows.setdefault(f"{item.kind} {item.id}", [Row(item.id, item.kind, status, one) for one in records])
    return [row for some in rows.values() for row in some]


def rows_of(path: Path) -> list[Row]:
    """Return a row for each record in a file of evidence, whose plugins need not be installed."""
    return [
        Row(f"{one['distribution']}:{one['name']}", one["kind"], f"by mbdkit {one['mbdkit']} on {one['date']}", one)
        for one in read_records(path)
    ]


def verified_row(item: Registered, options: Mapping[str, Any], *, quick: bool) -> Row:
    """Verify a plugin now."""
    report = verify(item.kind, item.id, options, quick=quick)
    return Row(item.id, item.kind, report.verdict(), record_of(item, report, quick=quick))


def rows_against(path: Path, *, quick: bool, watch: Callable[[str], None]) -> list[Row]:
    """Verify everything again that a file of evidence is about, and return rows that say what does not hold any more.

    Raises SpecError if the file is no evidence, or one of its plugins is not installed.
    """
    try:
        records = read_records(path)
    except ValueError as error:
        raise SpecError(f"this is no evidence: {error}", file=path) from None
    if not records:
        raise SpecError("there is no such evidence", file=path)
    rows = []
    for old in records:
        item = registry().get(old["kind"], f"{old['distribution']}:{old['name']}")
        watch(f"{item.id} {old['options'] or ''}")
        now = verified_row(item, options_of(item, old), quick=quick or old["quick"])
        before = {name: old["checks"].get(name, {}).get("outcome", "skip") for name in now.record["failed"]}
        broken = [(name, was, now.checks[name].get("cause", "fail")) for name, was in before.items() if was != "fail"]
        rows.append(replace(now, broken=[f"{name}: {was} before, now: {cause}" for name, was, cause in broken]))
    return rows


def check_files(folder: Path, *, overwrite: bool) -> None:
    """Raise SpecError if the files of a matrix cannot be written."""
    for path in [folder / name for name in _FILES] if folder.is_dir() else [folder]:
        check_output(path, overwrite=overwrite)


def write_matrix(rows: Sequence[Row], folder: Path) -> None:
    """Write page, CSV and JSON."""
    data = {"mbdkit": mbdkit.__version__, "rows": [vars(row) for row in rows]}
    texts = html(rows), table_csv(rows), json_text(data)
    folder.mkdir(exist_ok=True)
    for name, text in zip(_FILES, texts, strict=True):
        with replacing(folder / name, overwrite=True) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")


def tables(rows: Sequence[Row]) -> list[tuple[str, list[str], list[tuple[int, Row, dict[str, tuple[str, str]]]]]]:
    """Return for each kind its name, the headings of its columns, and its rows with their numbers and cells."""
    result = []
    for kind in sorted({row.kind for row in rows}, key=KINDS_IN_MATRIX.index):
        own = [(number, row, row.cells()) for number, row in enumerate(rows) if row.kind == kind]
        headings = list(dict.fromkeys(heading for _, _, cells in own for heading in cells))
        used = [heading for heading in headings if any(cells.get(heading, ("",))[0] for _, _, cells in own)]
        result.append((KINDS[kind].label(), used, own))
    return result


def table_csv(rows: Sequence[Row]) -> str:
    """Return the matrix as CSV, with a line for each row and the columns of all kinds."""
    every = tables(rows)
    headings = list(dict.fromkeys(heading for _, used, _ in every for heading in used))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["id", "kind", "options", "status", "broken", *headings])
    for _, row, cells in (entry for _, _, own in every for entry in own):
        known = [cells.get(heading, ("",))[0] for heading in headings]
        writer.writerow([row.id, row.kind, row.options, row.status, "; ".join(row.broken), *known])
    return stream.getvalue()


def html(rows: Sequence[Row], *, is_page: bool = True) -> str:
    """Return the matrix as a page, or as a part of a page."""
    values = {"tables": tables(rows), "rows": rows, "version": mbdkit.__version__, "is_page": is_page}
    return render("matrix.html", values)
