"""Loading of specs of inverse dynamics, changes of their values, and their JSON schema."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from mbdkit.base.plain_data import Path as KeyPath
from mbdkit.registry.catalogue import Registry
from mbdkit.registry.manager import registry
from mbdkit.spec.loading import loaded
from mbdkit.spec.reading import Document, put
from mbdkit.spec.schema import model_schema
from mbdkit.spec.spec_kinds import spec_loader, spec_schema
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import InverseSpec, inverse_spec_type

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


@spec_schema
def inverse_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the spec of inverse dynamics.

    Parameters
    ----------
    installed
        Registry of the models and force laws to include; by default, all that are installed.
    """
    chosen = installed if installed is not None else registry()
    return model_schema(inverse_spec_type(chosen), chosen)
