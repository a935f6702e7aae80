"""Finds plugins that were used to create an archive but are not installed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest
from pathlib import Path

from mbdkit.base.errors import SpecError
from mbdkit.base.frozen import dataclass
from mbdkit.base.text import shown
from mbdkit.registry.catalogue import Kind
from mbdkit.registry.manager import registry


@dataclass(frozen=True)
class Needed:
    """A plugin that was used to create an archive.

    `kind`, `id`: kind and full name of the plugin. `distribution`, `version`: name and version of the distribution that
    contains the plugin. `group`: group of the archive that the plugin describes, if it is a kind of quantities.
    """

    kind: Kind
    id: str
    distribution: str
    version: str
    group: str = ""

    @property
    def advice(self) -> str:
        """What to install, as a clause. It contains no command, because an untrusted archive may contain harmful
        names.
        """
        return (
            f"install the distribution that the archive names, {shown(self.distribution)} {shown(self.version)}, "
            "if you trust both"
        )


def missing_plugins(provenance: Mapping[str, object]) -> tuple[Needed, ...]:
    """Return the plugins in a run's provenance that are not installed."""
    installed = {(item.kind, item.id) for item in registry().items}
    return tuple(needed for needed in _needed(provenance) if (needed.kind, needed.id) not in installed)


def _needed(provenance: Mapping[str, object]) -> Iterator[Needed]:
    kinds: tuple[tuple[Kind, str], ...] = (
        ("model", "model"),
        ("integrator", "integrator"),
        ("step-control", "step_control"),
        ("force-law", "force_laws"),
        ("spec-kind", "spec_kind"),
        ("quantity", "quantities"),
        ("joint-kind", "joint_kinds"),
        ("element-kind", "element_kinds"),
    )
    for kind, key in kinds:
        names = (key, f"{key}_distribution", f"{key}_version", f"{key}_group")
        columns = [str(provenance.get(name, "")).split(", ") for name in names]
        for item, origin, version, group in zip_longest(*columns, fillvalue=""):
            if item and origin and version:
                yield Needed(kind, item, origin, version, group)


def check_plugins_of(path: Path | None, provenance: Mapping[str, object]) -> None:
    """Raise SpecError if rerunning an archive needs plugins that are not installed."""
    if missing := missing_plugins(provenance):
        first = missing[0]
        word = first.kind.replace("-", " ")
        raise SpecError(
            f"the {word} '{shown(first.id)}' is not installed here; to run it again {first.advice}", file=path
        )
