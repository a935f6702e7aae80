"""JSON schema of design specs."""

from __future__ import annotations

from mbdkit.registry.catalogue import Registry
from mbdkit.spec.schema import DRAFT, allow_units, described, run_schema
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
    schema = allow_units(described(DesignSpec.model_json_schema()), "Variable", "Limit")
    run, measured = run_schema(installed), inverse_schema(installed)
    bases = {
        name: {"type": "object", "properties": one["properties"], "additionalProperties": False}
        for name, one in (("RunBase", run), ("InverseBase", measured))
    }
    for place in (schema, schema["$defs"]["Scenario"]):
        place["properties"]["base"]["anyOf"] = [{"type": "string"}, *({"$ref": f"#/$defs/{name}"} for name in bases)]
    schema["$defs"] |= measured["$defs"] | run["$defs"] | bases
    return {"$schema": DRAFT, **schema}
