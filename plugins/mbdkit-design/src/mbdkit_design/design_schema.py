"""JSON schema of design specs."""

from __future__ import annotations

from mbdkit.registry.catalogue import Registry
from mbdkit.spec.schema import schema_on_bases
from mbdkit.spec.spec_kinds import spec_schema
from mbdkit_biomech.inverse_dynamics.spec.inverse_schema import inverse_schema
from mbdkit_design.design_spec import DesignSpec


@spec_schema
def design_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the design spec; its bases are run specs and specs of inverse dynamics.

    Parameters
    ----------
    installed
        Registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    measured = {"InverseBase": inverse_schema(installed)}
    return schema_on_bases(DesignSpec, installed, measured, users=("Scenario",), quantities=("Variable", "Limit"))
