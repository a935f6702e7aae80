"""Table of the verification of all built-in integrators, for the README of this folder.

``python -m mbdkit_testing.verification_table README.md`` verifies them within a minute or two and replaces the table in
that file; without a file it prints the table. The exit status is 1 if an integrator is not verified.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from mbdkit_report import Trend
from mbdkit_testing.check_result import Figure, Report
from mbdkit_testing.kit import verify

ROUNDING = 1e-12  #: Change of energy [J] that counts as rounding.
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
VARIANTS: tuple[tuple[str, Mapping[str, object]], ...] = (
    ("rk4", {}),
    ("rk-gill", {}),
    *(("gauss", {"stages": s}) for s in range(1, 7)),
    ("gauss", {"stage_solver": "fixed-point"}),
    *(("radau-iia", {"stages": s}) for s in (2, 3, 5)),
    ("dopri5", {}),
    ("dop853", {}),
    ("taylor", {}),
    ("rattle", {}),
    ("lobatto-pair", {}),
    ("moreau-jean", {}),
    ("nonsmooth-generalized-alpha", {}),
    ("scipy-radau", {}),
    ("scipy-dop853", {}),
    ("scipy-lsoda", {}),
)
HEADING = (
    "method",
    "order claimed",
    "measured: forced",
    "driven",
    "four-bar",
    "drift of positions",
    "of velocities",
    "growth",
    "there and back",
    "in steps of [s]",
    "energy: orbit [J/s]",
    "jointed [J/s]",
    "checks",
)


def title(name: str, options: Mapping[str, object]) -> str:
    """Return the first cell of a row."""
    return " ".join([f"`{name}`", *(f"{value}" for value in options.values())])


def row(name: str, report: Report) -> list[str]:
    """Return the cells of one integrator."""

    def figure(check: str, key: str) -> str:
        return _shown(report[check].figures.get(key, ""))

    drifts = [_drift(report, level) for level in ("position", "velocity")]
    order = report.claims.get("order")
    return [
        title(name, report.options),
        "adaptive" if order is None else f"{order:g}",
        *(
            figure(f"order.{problem}", "measured") or "-"
            for problem in ("forced-pendulum", "driven-pendulum", "four-bar")
        ),
        *drifts,
        figure("drift.growth", "growth"),
        figure("geometry.reversibility-pendulum", "defect"),
        figure("geometry.reversibility-pendulum", "step_s") or "its own",
        _trend(report, "geometry.energy"),
        _trend(report, "geometry.energy-jointed"),
        f"{report.run} run, {len(report.of('skip'))} skipped, {len(report.of('fail'))} failed",
    ]


def _drift(report: Report, level: str) -> str:
    figures = report[f"drift.{level}"].figures
    return f"h^{figures['rate']:.2f}" if "rate" in figures else str(figures.get("drift", "-"))


def _trend(report: Report, check: str) -> str:
    figures = report[check].figures
    slope, error = figures.get("trend_J_per_s"), figures.get("error_J_per_s")
    if not isinstance(slope, float) or not isinstance(error, float):
        return "-"
    largest = figures["largest_J"]
    rounding = isinstance(largest, float) and largest < ROUNDING
    return "none" if abs(slope) < Trend.SURE * error or rounding else f"{slope:.0e}"


def _shown(value: Figure) -> str:
    if isinstance(value, float):
        return f"{value:.2f}" if 0.01 <= abs(value) < 100 else f"{value:.0e}"
    return str(value)


def markdown(reports: Sequence[tuple[str, Report]]) -> str:
    """Return the table in Markdown."""
    rows = [HEADING, ["---"] * len(HEADING), *(row(name, report) for name, report in reports)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def main(files: Sequence[str]) -> int:
    """Verify all integrators, print the table or write it into files, and return the exit status."""
    reports = []
    for name, options in VARIANTS:
        report = verify("integrator", f"mbdkit:{name}", options)
        print(f"{title(name, options)}: {report.verdict()}, in {report.seconds:.1f} s", file=sys.stderr)
        reports.append((name, report))
    text = markdown(reports)
    if not files:
        print(text)
    for file in files:
        before, _, rest = Path(file).read_text(encoding="utf-8").partition(BEGIN)
        _, _, after = rest.partition(END)
        Path(file).write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8", newline="\n")
    return 0 if all(report.verified for _, report in reports) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
