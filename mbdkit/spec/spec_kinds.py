"""The kinds of specs: which kind a document is of, and the error where a spec of another kind is given."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import cast

from pydantic import BaseModel

from mbdkit.base.distributions import MBDKIT
from mbdkit.base.errors import MissingPartError, SpecError
from mbdkit.base.parts import MARKERS_OF_PARTS
from mbdkit.base.text import listed
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.feature_items import SpecKind
from mbdkit.registry.manager import registry
from mbdkit.registry.seam import Seam
from mbdkit.spec.reading import Document

#: A file, the name of an example, plain data, or a document.
Source = str | Path | Mapping[str, object] | Document


def spec_kinds() -> list[SpecKind]:
    """Return the kinds of specs in the order in which they are recognised; run specs come last."""
    return [cast(SpecKind, item.plugin) for item in registry().of_kind("spec-kind")]


def kind_named(name: str) -> SpecKind:
    """Return the kind of specs with a name; raise SpecError if there is none."""
    return cast(SpecKind, registry().get("spec-kind", name).plugin)


def kind_of(data: Mapping[str, object]) -> SpecKind:
    """Return the kind of a spec, given as plain data; raise SpecError if the part for its kind is not installed."""
    kinds = spec_kinds()
    for marker, part in MARKERS_OF_PARTS.items():
        if marker in data and all(kind.marker != marker for kind in kinds):
            raise SpecError(str(MissingPartError("a spec with this key", part)), key=marker)
    items = registry().of_kind("spec-kind")
    added = [item for item in items if item.origin.distribution != MBDKIT]
    own = [cast(SpecKind, item.plugin) for item in items if item.origin.distribution == MBDKIT]
    marked = [item for item in added if cast(SpecKind, item.plugin).marker in data]
    if not marked or any(kind.marker in data for kind in own):  # kinds of other distributions never replace our own
        return next(kind for kind in own if kind.recognises(data))
    if len(marked) > 1:
        names = listed([f"'{item.id}'" for item in marked], "and")
        raise SpecError(f"this may be a spec of the kinds {names}; exclude one by MBDKIT_DISABLE_PLUGINS")
    return cast(SpecKind, marked[0].plugin)


def refused(data: Mapping[str, object], wanted: str) -> SpecError | None:
    """Return the error for a spec of another kind than the one with the name `wanted`; None if it may be of this
    kind.
    """
    kind = kind_of(data)
    if kind.name != wanted and kind.marker in data:
        return SpecError(kind.given_instead, key=kind.marker)
    if kind.name != wanted and "integrator" in data:
        return SpecError(kind_named(wanted).run_instead, key="integrator")
    return None


@Seam
def spec_loader(source: Source, assignments: Iterable[str], /) -> BaseModel:
    """Load and validate a spec.

    `source` is a file, the name of an example, a document or a mapping; `assignments` are texts such as
    ``time.step=0.005``.
    """
    raise NotImplementedError


@Seam
def spec_check(source: Document | str, name: str, assignments: list[str], /) -> None:
    """Check a document or a packaged spec, which has a name for messages, and print what it defines."""
    raise NotImplementedError


@Seam
def packaged_spec(name: str, /) -> bool:
    """Return whether a name is that of a packaged spec that is no example."""
    raise NotImplementedError


@Seam
def spec_schema(installed: Registry | None, /) -> dict[str, object]:
    """Return the JSON schema of specs with the items of a registry, by default all installed ones."""
    raise NotImplementedError
