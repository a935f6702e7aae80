"""What came of a check, and of all checks of one plugin."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from mbdkit.registry.catalogue import Kind
from mbdkit.text import counted, listed, table

Outcome = Literal["pass", "fail", "warn", "skip"]
Figure = float | int | str

NEEDED: dict[Kind, str] = {"integrator": "geometry", "model": "energy", "force-law": "derivatives", "study": "study"}
"""For each kind the room of which a check must have run before the plugin counts as verified."""


@dataclass(frozen=True)
class Finding:
    """What one check came to.

    Parameters
    ----------
    outcome
        ``warn`` is a pass that the author should look at; ``skip`` says nothing about the plugin.
    cause
        Why, in one sentence without a full stop; empty where all is as claimed.
    figures
        What was measured, by name; units stand in the names.
    """

    outcome: Outcome
    cause: str = ""
    figures: dict[str, Figure] = field(default_factory=dict)


def passed(**figures: Figure) -> Finding:
    """Return that all is as claimed."""
    return Finding("pass", "", figures)


def failed(cause: str, **figures: Figure) -> Finding:
    """Return that the plugin does not do what it claims, or what every plugin must."""
    return Finding("fail", cause, figures)


def warned(cause: str, **figures: Figure) -> Finding:
    """Return that nothing is wrong, but that the author should know."""
    return Finding("warn", cause, figures)


def skipped(cause: str, **figures: Figure) -> Finding:
    """Return that the check does not apply, or could tell nothing."""
    return Finding("skip", cause, figures)


@dataclass(frozen=True)
class Result:
    """One check that was carried out.

    Attributes
    ----------
    name
        ``room.check``, such as ``order.four-bar``.
    what
        What it does, in one sentence.
    outcome, cause, figures
        What it came to; see `Finding`.
    seconds
        How long it took.
    """

    name: str
    what: str
    outcome: Outcome
    cause: str
    figures: dict[str, Figure]
    seconds: float

    @property
    def room(self) -> str:
        """What stands before the dot of its name."""
        return self.name.partition(".")[0]


@dataclass(frozen=True)
class Report:
    """All checks of one plugin.

    Attributes
    ----------
    id, kind, version
        What was checked: its long id, its kind, and the version of its distribution.
    options
        With which options.
    claims
        What it claims with these.
    results
        The checks, in the order in which they were carried out.
    """

    id: str
    kind: Kind
    version: str
    options: dict[str, Any]
    claims: dict[str, Any]
    results: tuple[Result, ...]

    def of(self, outcome: Outcome) -> list[Result]:
        """Return the checks with one outcome."""
        return [result for result in self.results if result.outcome == outcome]

    def __getitem__(self, name: str) -> Result:
        """Return the check of this name."""
        return next(result for result in self.results if result.name == name)

    @property
    def run(self) -> int:
        """How many checks were carried out; those skipped were not."""
        return len(self.results) - len(self.of("skip"))

    @property
    def missing(self) -> str:
        """The room of which a check has to be carried out and none was; empty if there is none."""
        room = NEEDED[self.kind]
        done = any(result.room == room and result.outcome != "skip" for result in self.results)
        return "" if done else room

    @property
    def verified(self) -> bool:
        """Whether nothing failed, and the checks that matter most were carried out."""
        return not self.of("fail") and not self.missing

    @property
    def seconds(self) -> float:
        """How long all checks took."""
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
        return f"not verified: no check of {self.missing} could be carried out; {counts}"

    def text(self) -> str:
        """Return the report as a table, with the cause of everything that is not a pass."""
        told = [(result, "; ".join(filter(None, [result.cause, figures_text(result)]))) for result in self.results]
        rows = [("CHECK", "OUTCOME", ""), *((result.name, result.outcome, text) for result, text in told)]
        head = f"{self.id} {self.version} ({self.kind})"
        if self.options:
            head += " with " + listed(f"{key} = {value}" for key, value in self.options.items())
        return f"{head}\n\n{table(rows, indent='  ')}\n\n{self.verdict()}, in {self.seconds:.0f} s"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values; numbers that are not finite become None."""
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
    """Return the measured figures of a check in one line."""
    return listed(f"{name} {_shown(value)}" for name, value in result.figures.items())


def _shown(value: Figure) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _plain(value: Figure) -> Figure | None:
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
