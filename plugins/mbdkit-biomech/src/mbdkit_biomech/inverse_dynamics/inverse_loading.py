"""Loading of specs of inverse dynamics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from mbdkit.spec.loading import loaded
from mbdkit_biomech.inverse_dynamics.inverse_spec import InverseSpec

InverseSource: TypeAlias = str | Path | Mapping[str, object] | InverseSpec
"""A file, the name of a packaged example, a mapping, or a validated spec of inverse dynamics."""


def load_inverse_spec(source: Any, overrides: Iterable[str] = (), **sections: Any) -> InverseSpec:
    """Load and validate a spec of inverse dynamics, build its mechanism, and return the spec.

    Parameters
    ----------
    source, overrides, sections
        See `load_spec`; the source may also be an `InverseSpec`.

    Raises
    ------
    SpecError
        If the spec is not valid, with the file, line and key path if known.
    """
    return loaded(InverseSpec, source, overrides, sections)
