"""Loading of specs of inverse dynamics, and changes of their values."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from mbdkit.base.plain_data import Path as KeyPath
from mbdkit.spec.loading import loaded
from mbdkit.spec.reading import Document, put
from mbdkit.spec.spec_kinds import spec_loader
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec

#: A file, the name of a packaged example, a mapping, or a validated spec of inverse dynamics.
InverseSource: TypeAlias = str | Path | Mapping[str, object] | InverseSpec


def load_inverse_spec(
    source: InverseSource | Document, assignments: Iterable[str] = (), **sections: object
) -> InverseSpec:
    """Load and validate a spec of inverse dynamics, build its mechanism, and return the spec.

    Parameters
    ----------
    source, assignments, sections
        See `load_spec`; the source may also be an `InverseSpec`.

    Raises
    ------
    SpecError
        If the spec is not valid, with the file, line and key path if known.
    """
    return loaded("inverse", InverseSpec, source, assignments, sections)


spec_loader(load_inverse_spec)


def varied_inverse(spec: InverseSpec, values: Sequence[tuple[KeyPath, object]]) -> InverseSpec:
    """Return a spec of inverse dynamics with values at key paths; raise SpecError if it is not valid."""
    data = json.loads(spec.canonical_json())
    for path, value in values:
        put(data, path, value)
    varied = InverseSpec(**data)
    varied._document = spec._document
    return varied
