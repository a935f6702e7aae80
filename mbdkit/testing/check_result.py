"""The result of one check, and the report of all checks of one plugin."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from mbdkit.registry.catalogue import Kind
from mbdkit.text import counted, listed, table

Outcome = Literal["pass", "fail", "warn", "skip"]
Figure = float | int | str

REQUIRED_GROUP: dict[Kind, str] = {
    "integrator": "geometry",
    "model": "energy",
    "force-law": "derivatives",
    "study": "study",
    "measure": "measure",
}
"""Group of checks, for each kind of plugin, of which at least one must have run for the plugin to be verified."""


@dataclass(frozen=True)
class Result:
    """Result of a check.

    A check function returns the first three fields, by `passed`, `failed`, `warned` or `skipped`; `Check.run` adds the
    others.

    Parameters
    ----------
    outcome
        ``pass``; ``fail``; ``warn``, a pass with a remark for the author; or ``skip``, if the check does not apply.
    cause
        Reason in one sentence without a full stop; empty for a plain pass.
    figures
        Measured values by name; units are part of the names.
    name
        ``group.check``, such as ``order.four-bar``.
    what
        What the check requires, in one sentence.
    seconds
        Duration [s].
    """

    outcome: Outcome
    cause: str = ""
    figures: dict[str, Figure] = field(default_factory=dict)
    name: str = ""
    what: str = ""
    seconds: float = 0.0

    @property
    def group(self) -> str:
        """The part of the name before the dot."""
        return self.name.partition(".")[0]


def passed(**figures: Figure) -> Result:
    """Return the result of a check that passed."""
    return Result("pass", "", figures)


def failed(cause: str, **figures: Figure) -> Result:
    """Return the result of a check that failed: the plugin breaks its claim or the contract."""
    return Result("fail", cause, figures)


def warned(cause: str, **figures: Figure) -> Result:
    """Return the result of a check that passed with a remark for the author."""
    return Result("warn", cause, figures)


def skipped(cause: str, **figures: Figure) -> Result:
    """Return the result of a check that does not apply or is inconclusive."""
    return Result("skip", cause, figures)


@dataclass(frozen=True)
class Report:
    """Results of all checks of one plugin.

    Parameters
    ----------
    id, kind, version
        Long id and kind of the plugin, and version of its distribution.
    claims
        Claims of the plugin with these options.
    results
        Results in the order of the checks.
    """

    id: str
    kind: Kind
    version: str
    options: dict[str, Any]
    claims: dict[str, Any]
    results: tuple[Result, ...]

    def of(self, outcome: Outcome) -> list[Result]:
        """Return the results with this outcome."""
        return [result for result in self.results if result.outcome == outcome]

    def __getitem__(self, name: str) -> Result:
        """Return the result of the check of this name."""
        return next(result for result in self.results if result.name == name)

    @property
    def run(self) -> int:
        """Number of checks that were not skipped."""
        return len(self.results) - len(self.of("skip"))

    @property
    def missing(self) -> str:
        """The required group, if all its checks were skipped; else empty."""
        group = REQUIRED_GROUP[self.kind]
        done = any(result.group == group and result.outcome != "skip" for result in self.results)
        return "" if done else group

    @property
    def verified(self) -> bool:
        """Whether no check failed and a check of the required group was run."""
        return not self.of("fail") and not self.missing

    @property
    def seconds(self) -> float:
        """Duration of all checks [s]."""
        return sum(result.seconds for result in self.results)

    def verdict(self) -> str:
        """Return the outcome in one sentence."""
        counts = f"{counted(self.run, 'check')} run"
        if warnings := self.of("warn"):
            counts += f", {counted(len(warnings), 'warning')}"
        if left := self.of("skip"):
            counts += f", {len(left)} skipped"
        if self.verified:
            return f"verified: {counts}"
        if failures := self.of("fail"):
            return f"not verified: {len(failures)} failed ({listed(r.name for r in failures)}); {counts}"
        return f"not verified: no check of the group {self.missing} could be run; {counts}"

    def text(self) -> str:
        """Return the report as a table with causes and measured values."""
        told = [(result, "; ".join(filter(None, [result.cause, figures_text(result)]))) for result in self.results]
        rows = [("CHECK", "OUTCOME", ""), *((result.name, result.outcome, text) for result, text in told)]
        head = f"{self.id} {self.version} ({self.kind})"
        if self.options:
            head += " with " + listed(f"{key} = {value}" for key, value in self.options.items())
        return f"{head}\n\n{table(rows, indent='  ')}\n\n{self.verdict()}, in {self.seconds:.0f} s"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON values; numbers that are not finite become None."""
        results = [asdict(result) for result in self.results]
        for result in results:
            result["figures"] = {key: _plain(value) for key, value in result["figures"].items()}
        return {
            "id": self.id,
            "kind": self.kind,
            "version": self.version,
            "options": self.options,
            "claims": self.claims,
            "verified": self.verified,
            "verdict": self.verdict(),
            "run": self.run,
            "failed": len(self.of("fail")),
            "warned": len(self.of("warn")),
            "skipped": len(self.of("skip")),
            "seconds": self.seconds,
            "checks": results,
        }


def figures_text(result: Result) -> str:
    """Return the measured values of a result in one line."""
    return listed(f"{name} {_shown(value)}" for name, value in result.figures.items())


def _shown(value: Figure) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _plain(value: Figure) -> Figure | None:
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
