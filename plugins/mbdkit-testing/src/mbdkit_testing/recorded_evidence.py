"""Evidence of verifications: `mbdkit plugins verify --record` writes the results of all checks into the package.

`mbdkit.runs.method_evidence` reads it. Figures have few digits, so that a file differs little from one machine to the
next.
"""

from __future__ import annotations

import json
import platform
import sysconfig
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mbdkit.base.distributions import MBDKIT, own_version, required_versions
from mbdkit.base.errors import SpecError
from mbdkit.base.files import replacing
from mbdkit.engine.native.machine_code import code_id
from mbdkit.registry.catalogue import Kind, Origin, Registered
from mbdkit.runs import method_evidence
from mbdkit.runs.method_evidence import FORMAT, FORMAT_VERSION, code_digest, evidence_file, read_records, seal_of
from mbdkit_testing.check_result import Figure, Report

#: Kinds of plugins of which all items are verified if the name of their distribution is given.
KINDS: tuple[Kind, ...] = ("integrator", "force-law", "element-kind", "joint-kind", "model", "measure")
_KIT = Origin("mbdkit-testing", "", "kit = mbdkit_testing")
_PACKAGE = "PACKAGE"  #: Stands for the folder of the package in options that are paths.
_OF_MACHINE = ("us_per_step", "stopped_at_s")  #: Figures that differ from one run to the next.

Record = dict[str, Any]


def record_of(item: Registered, report: Report, *, quick: bool) -> Record:
    """Return the record of a report as JSON values."""
    checks: Record = {}
    for result in report.results:
        if result.outcome != "skip":
            figures = {name: _few_digits(x) for name, x in result.figures.items() if name not in _OF_MACHINE}
            entry: Record = {"outcome": result.outcome, "cause": result.cause, "figures": figures}
            checks[result.name] = {key: value for key, value in entry.items() if value}
    record: Record = {
        "kind": item.kind,
        "distribution": item.origin.distribution,
        "name": item.name,
        "options": _moved(report.options, str(method_evidence.code_of(item.origin)), _PACKAGE),
        "version": item.origin.version,
        "digest": code_digest(item.origin),
        "mbdkit": own_version(),
        "requires": required_versions(item.origin.distribution),
        "kit": code_digest(_KIT)[:16],
        "python": platform.python_version(),
        "machine_code": code_id(),
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "seed": "fixed by the kit",
        "quick": quick,
        "verified": report.verified,
        "claims": {name: value for name, value in report.claims.items() if value},
        "failed": [result.name for result in report.of("fail")],
        "skipped": [result.name for result in report.of("skip")],
        "not_looked_at": report.not_looked_at,
        "checks": checks,
    }
    record = json.loads(json.dumps(record))  # tuples become lists
    return record | {"sha256": seal_of(record)}


def _moved(options: Mapping[str, Any], folder: str, other: str) -> dict[str, Any]:
    """Return options in which the paths of files in a folder are those in another one."""
    return {
        key: other + value.removeprefix(folder) if isinstance(value, str) and value.startswith(folder) else value
        for key, value in options.items()
    }


def options_of(item: Registered, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a record."""
    return _moved(record["options"], _PACKAGE, str(method_evidence.code_of(item.origin)))


def _few_digits(value: Figure) -> Figure:
    if not isinstance(value, float):
        return value
    digits = 3 if 0.01 <= abs(value) < 100.0 else 1 if abs(value) < 1e-11 else 2
    rounded = float(f"{value:.{digits}g}")
    return rounded if abs(rounded) < float("inf") else str(rounded)  # also of nan


def renew(item: Registered, report: Report, *, quick: bool) -> None:
    """Write the record of a report into the source tree of a plugin, unless the record there is of the same code."""
    record = record_of(item, report, quick=quick)
    is_current = any(_key(one) == _key(record) and one["digest"] == record["digest"] for one in records_of(item))
    if not is_current and not _is_installed(path := evidence_file(item.origin)):
        write_records([record], path)


def _is_installed(path: Path) -> bool:
    return any(path.is_relative_to(sysconfig.get_path(name)) for name in ("purelib", "platlib"))


def place_of_evidence(items: Sequence[Registered], output: Path | None) -> Path:
    """Return the file into which the evidence of plugins is written.

    Raises SpecError if it belongs to an installation, and the user does not name it.
    """
    path = evidence_file(items[0].origin)
    if output is None and _is_installed(path):
        raise SpecError(
            f"{items[0].origin.distribution} is not installed from its source tree; name the file of the evidence with "
            f"-o, or install the source tree with `pip install -e`. Runs look for {path}"
        )
    return output or path


def recorded_options(item: Registered, path: Path) -> list[dict[str, Any]]:
    """Return the options with which an item was verified, its defaults first."""
    known = [options_of(item, one) for one in _known(path) if (one["kind"], one["name"]) == (item.kind, item.name)]
    return known or [{}]


def _known(path: Path) -> Sequence[Mapping[str, Any]]:
    try:
        return read_records(path)
    except ValueError as error:
        raise SpecError(f"this is no evidence that can be continued: {error}", file=path) from None


def write_records(records: Iterable[Record], path: Path) -> None:
    """Write records into a file, in which they replace those of the same items and options."""
    every = {_key(record): record for record in (*_known(path), *records)}
    lines = ",\n".join(_lines(every[key]) for key in sorted(every))
    head = f'{{\n "format": "{FORMAT}",\n "format_version": {FORMAT_VERSION},\n "records": [\n'
    with replacing(path, overwrite=True) as temporary:
        temporary.write_text(f"{head}{lines}\n ]\n}}\n", encoding="utf-8", newline="\n")
    method_evidence.forget()


def _key(record: Mapping[str, Any]) -> tuple[str, str, str]:
    return record["kind"], record["name"], json.dumps(record["options"], sort_keys=True)


def _lines(record: Mapping[str, Any]) -> str:
    """Return a record as JSON with a line for each entry and each check, whose differences are easy to read."""
    lines = [f'   "{key}": {json.dumps(value)}' for key, value in record.items() if key not in ("checks", "sha256")]
    checks = ",\n".join(f'    "{name}": {json.dumps(entry)}' for name, entry in record["checks"].items())
    lines += [f'   "checks": {{\n{checks}\n   }}', f'   "sha256": "{record["sha256"]}"']
    return "  {\n" + ",\n".join(lines) + "\n  }"


def status_of(item: Registered) -> str:
    """Return what is known of the verification of an item; empty for items of which no evidence is recorded."""
    is_of_kind = item.kind in KINDS and (item.origin.distribution != MBDKIT or item.kind == "integrator")
    return str(method_evidence.evidence_of(item)) if is_of_kind else ""


def record_texts(item: Registered) -> Iterator[str]:
    """Yield for each record of an item its options, numbers of checks, and measured orders."""
    for record in records_of(item):
        figures = {name: entry.get("figures", {}) for name, entry in record["checks"].items()}
        orders = [f"{name} {found['measured']}" for name, found in figures.items() if "measured" in found]
        counts = f"{len(figures)} checks run, {len(record['failed'])} failed, {len(record['skipped'])} skipped"
        chosen = ", ".join(f"{key} {value}" for key, value in record["options"].items()) or "default options"
        yield "; ".join([f"{chosen}: {counts}", *orders])


def records_of(item: Registered) -> list[Mapping[str, Any]]:
    """Return the records of an item; empty if there are none, or if the file is damaged."""
    try:
        known = read_records(evidence_file(item.origin))
    except ValueError:
        return []
    return [record for record in known if (record["kind"], record["name"]) == (item.kind, item.name)]
