"""JSON schema of the specs of inverse dynamics."""

from __future__ import annotations

from mbdkit.registry.catalogue import Registry
from mbdkit.registry.manager import registry
from mbdkit.spec.schema import model_schema
from mbdkit.spec.spec_kinds import spec_schema
from mbdkit_biomech.inverse_dynamics.spec.inverse_spec import inverse_spec_type


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
