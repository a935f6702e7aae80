"""The findings of criteria, those of mbdkit and those of plugins."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import lru_cache
from typing import Any, Literal, cast

from mbdkit.registry.catalogue import Registered, Registry
from mbdkit.registry.feature_items import CriterionItem
from mbdkit.registry.manager import registry, use
from mbdkit.trust.finding import Finding

Stage = Literal["spec", "start", "rows", "end", "data"]


@lru_cache(maxsize=64)
def _criteria_of(known: Registry, stage: Stage, kind: str) -> tuple[tuple[Registered, CriterionItem], ...]:
    """Return the criteria of a stage for specs of a kind, in their order."""
    pairs = [(item, cast(CriterionItem, item.plugin)) for item in known.of_kind(CriterionItem.kind)]
    return tuple((item, one) for item, one in pairs if one.stage == stage and kind in one.of)


def criteria(stage: Stage, spec: Any = None, kind: str = "run") -> list[tuple[Registered, CriterionItem]]:
    """Return the criteria of a stage for the result of a spec, or for any spec, in their order."""
    known = _criteria_of(registry(), stage, kind)
    if spec is None or not any(criterion.elements for _, criterion in known):
        return list(known)
    elements = spec.mechanism().elements
    return [
        (item, criterion)
        for item, criterion in known
        if not criterion.elements or (criterion.elements in elements and criterion.examines(elements))
    ]


def findings(stage: Stage, *examined: object, kind: str = "run") -> list[Finding]:
    """Return what all criteria of a stage find in the objects that are examined; see `CriterionItem`."""
    found: list[Finding] = []
    for item, criterion in criteria(stage, examined[0], kind):
        results = use(item, lambda: [*criterion.find()(*examined)])  # type: ignore[operator]  # noqa: B023
        if results:
            found += use(item, lambda: [*as_findings(criterion, results)])  # noqa: B023
    return found


def as_findings(criterion: CriterionItem, results: Iterable[str | Finding]) -> Iterator[Finding]:
    """Yield what a criterion has found; sentences become findings of its name and level."""
    for finding in results:
        if not isinstance(finding, str | Finding):
            raise TypeError(f"it found {finding!r}, which is neither a sentence nor a Finding")
        yield Finding(criterion.name, criterion.level, finding, is_named=False) if isinstance(finding, str) else finding
