"""The result of one check, and the report of all checks of one plugin."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from textwrap import fill
from typing import Any, Literal

from mbdkit.base.plain_data import json_text
from mbdkit.base.text import counted, listed, shown, table
from mbdkit.registry.catalogue import Kind

Outcome = Literal["pass", "fail", "warn", "not claimed", "skip"]
Figure = float | int | str

#: For each kind of plugin, the group of checks of which at least one must have run for the plugin to be verified.
REQUIRED_GROUP: dict[Kind, str] = {
    "integrator": "geometry",
    "model": "energy",
    "force-law": "derivatives",
    "study": "study",
    "measure": "measure",
    "element-kind": "energy",
    "joint-kind": "energy",
}
#: What the checks of a kind of plugin do not look at, besides what is not looked at for any kind.
NOT_LOOKED_AT: dict[Kind, str] = {
    "integrator": "iterations whose tolerance is no option, data that runs of other models leave behind, ",
    "element-kind": "the reaction of the ground where forces depend on the places of bodies, ",
    "joint-kind": "rows away from the example's motion and from some lines through its start, ",
    "measure": "rows at unequal intervals, ",
    "force-law": "lengths, rates and times beyond those of the samples, ",
}


@dataclass(frozen=True)
class Result:
    """Result of a check.

    A check function creates a result with `passed`, `failed`, `warned`, `unclaimed` or `skipped`, and may add `limits`
    with `within`. `Check.run` adds `name`, `what` and `seconds`.

    Parameters
    ----------
    outcome
        ``pass``; ``fail``; ``warn``, a pass with a remark for the author; ``not claimed``, if a property was measured
        that the plugin does not claim; or ``skip``, if the check does not apply.
    cause
        Reason in one sentence without a full stop; empty for a plain pass.
    figures
        Measured values by name; units are part of the names.
    name
        ``group.check``, such as ``order.four-bar``.
    what
        What the check requires, in one sentence.
    seconds
        Processor time [s].
    limits
        Limits of the measured values by name: a number that the value may not exceed, or a phrase.
    """

    outcome: Outcome
    cause: str = ""
    figures: dict[str, Figure] = field(default_factory=dict)
    name: str = ""
    what: str = ""
    seconds: float = 0.0
    limits: dict[str, float | str] = field(default_factory=dict)

    @property
    def group(self) -> str:
        """The part of the name before the dot."""
        return self.name.partition(".")[0]

    def within(self, limits: Mapping[str, float | str]) -> Result:
        """Return the result with the limits to which the measured values are compared."""
        return replace(self, limits=dict(limits))


def passed(**figures: Figure) -> Result:
    """Return the result of a check that passed."""
    return Result("pass", "", figures)


def at_most(limit: float | Mapping[str, float], cause: str, **figures: float) -> Result:
    """Return a pass if all figures, or those named in a mapping, are within their limit; else a failure for a cause."""
    limits = limit if isinstance(limit, Mapping) else dict.fromkeys(figures, limit)
    is_within = all(figures[name] <= most for name, most in limits.items())
    return passed(**figures).within(limits) if is_within else failed(cause, **figures)


def failed(cause: str, **figures: Figure) -> Result:
    """Return the result of a check that failed: the plugin breaks its claim or the contract."""
    return Result("fail", cause, figures)


def warned(cause: str, **figures: Figure) -> Result:
    """Return the result of a check that passed with a remark for the author."""
    return Result("warn", cause, figures)


def unclaimed(**figures: Figure) -> Result:
    """Return the result of a check that measured a property which the plugin does not claim."""
    return Result("not claimed", "", figures)


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
    options
        Options of the plugin.
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
        """Return the results with the given outcome."""
        return [result for result in self.results if result.outcome == outcome]

    def __getitem__(self, name: str) -> Result:
        """Return the result of the check with this name."""
        return next(result for result in self.results if result.name == name)

    @property
    def run(self) -> int:
        """Number of checks that were not skipped."""
        return len(self.results) - len(self.of("skip"))

    @property
    def missing(self) -> str:
        """The group of checks that `REQUIRED_GROUP` names, if none of its checks was run; otherwise empty."""
        group = REQUIRED_GROUP.get(self.kind, "contract")
        done = any(result.group == group and result.outcome != "skip" for result in self.results)
        return "" if done else group

    @property
    def not_looked_at(self) -> str:
        """What no check looks at, in one sentence without a full stop."""
        return f"not looked at: {NOT_LOOKED_AT.get(self.kind, '')}modules imported by name, other options"

    @property
    def verified(self) -> bool:
        """Whether no check failed, and at least one check of the required group was run."""
        return not self.of("fail") and not self.missing

    @property
    def seconds(self) -> float:
        """Processor time of all checks [s]."""
        return sum(result.seconds for result in self.results)

    def verdict(self, *, names: bool = True) -> str:
        """Return the outcome in one sentence, with the names of failed checks unless `names` is false."""
        counts = f"{counted(self.run, 'check')} run"
        if warnings := self.of("warn"):
            counts += f", {counted(len(warnings), 'warning')}"
        if unclaimed := self.of("not claimed"):
            counts += f", {len(unclaimed)} of properties that are not claimed"
        if left := self.of("skip"):
            counts += f", {len(left)} skipped"
        if self.verified:
            return f"verified: {counts}"
        if failures := self.of("fail"):
            named = f" ({listed(r.name for r in failures)})" if names else ""
            return f"not verified: {len(failures)} failed{named}; {counts}"
        return f"not verified: no check of the group {self.missing} could be run; {counts}"

    def text(self) -> str:
        """Return the report as a table with causes and measured values, followed by the causes of several failures.

        Exceptions of the plugin that caused several failures come first.
        """
        shared = self._shared_causes()
        told_below = {result.name for results in shared.values() for result in results}
        rows = [("CHECK", "OUTCOME", "")]
        rows += [(one.name, one.outcome, _told(one)) for one in self.results if one.name not in told_below]
        head = f"{self.id} {self.version} ({self.kind})"
        if self.options:
            head += " with " + listed(f"{key} = {value}" for key, value in self.options.items())
        raised = sorted(filter(_RAISED.search, shared), key=lambda cause: -len(shared[cause]))
        others = [cause for cause in shared if cause not in raised]
        told = {cause: _paragraph(cause, results) for cause, results in shared.items()}
        parts = [*(told[cause] for cause in raised), *([table(rows, indent="  ")] if len(rows) > 1 else [])]
        verdict = f"{self.verdict(names=not shared)}, in {self.seconds:.0f} s of processor time"
        return "\n\n".join([head, *parts, *(told[cause] for cause in others), self.not_looked_at, verdict])

    def _shared_causes(self) -> dict[str, list[Result]]:
        """Return the causes that several checks have in common, at least one of which failed, with their results."""
        by_cause: dict[str, list[Result]] = {}
        for result in self.results:
            if result.outcome in ("fail", "skip"):
                by_cause.setdefault(_root(result.cause), []).append(result)
        return {
            results[0].cause: results
            for results in by_cause.values()
            if len(results) > 1 and any(result.outcome == "fail" for result in results)
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the report as JSON values; measured values that are not finite become None."""
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
            "not_claimed": len(self.of("not claimed")),
            "skipped": len(self.of("skip")),
            "seconds": self.seconds,
            "not_looked_at": self.not_looked_at,
            "checks": json.loads(json_text([asdict(result) for result in self.results])),
        }


#: An exception of a plugin in a cause, with its type and the line of the plugin that raised it.
_RAISED = re.compile(r"raised (\w+):.* \((.+, line \d+)\)")


NAMED = 12  #: Largest number of checks with one cause that a report names; further ones are only counted.

#: A cause within the sentence of a run whose method could not be created.
_START = re.compile(r".* failed to start: (?:\w+: )?(.*?)(?: \([^()]+, line \d+\))?")


def _root(cause: str) -> str:
    """Return a text that is equal for causes with the same root: an exception in a line of the plugin, or the cause."""
    if (found := _RAISED.search(cause)) is not None:
        return f"{found[1]} {found[2]}"
    return found[1] if (found := _START.fullmatch(cause)) else cause


def _paragraph(cause: str, results: Sequence[Result]) -> str:
    """Return the cause of several results, with their number and names."""
    found = _RAISED.search(cause)
    failed, skips = ([result.name for result in results if result.outcome == what] for what in ("fail", "skip"))
    skipped = f", {len(skips)} skipped" if skips else ""
    told = shown(cause if found is None else f"the plugin {found[0]}")
    lines = [
        f"{what}: {listed(names, most=NAMED)}" for what, names in (("failed", failed), ("skipped", skips)) if names
    ]
    wrapped = [fill(line, 118, initial_indent="  ", subsequent_indent="    ", break_on_hyphens=False) for line in lines]
    return "\n".join([f"{counted(len(failed), 'check')} failed{skipped}: {told}", *wrapped])


def _told(result: Result) -> str:
    """Return the text of a result in the report: its cause, its measured values, and sometimes its requirement.

    The requirement is included for results without limits that passed or are not claimed, because the meaning of their
    values is otherwise unclear.
    """
    required = result.what.rstrip(".") if result.outcome in ("pass", "not claimed") and not result.limits else ""
    return "; ".join(filter(None, [result.cause, figures_text(result), required]))


def figures_text(result: Result) -> str:
    """Return the measured values of a result in one line, with their limits."""
    return listed(f"{name} {_shown(value)}{_limit(result, name)}" for name, value in result.figures.items())


def _limit(result: Result, name: str) -> str:
    if (limit := result.limits.get(name)) is None:
        return ""
    return f" ({limit})" if isinstance(limit, str) else f" (at most {limit:g})"


def _shown(value: Figure) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
