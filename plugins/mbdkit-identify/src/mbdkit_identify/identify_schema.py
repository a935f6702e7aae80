"""The JSON schema of the spec of an identification."""

from __future__ import annotations

from mbdkit.plugin.seams import spec_schema
from mbdkit.plugin.specs import Registry, schema_with_bases
from mbdkit_identify.identify_spec import IdentifySpec


@spec_schema
def identify_schema(installed: Registry | None = None) -> dict[str, object]:
    """Return the JSON schema (draft 2020-12) of the spec of an identification, whose base is a run spec.

    Parameters
    ----------
    installed
        Registry of the models, integrators and force laws to include; by default, all that are installed.
    """
    schema = schema_with_bases(IdentifySpec, {"RunBase": "run"}, installed, units=set())
    for key in ("observed", "inputs"):  # the heading of a column stands for a signal
        columns = schema["$defs"]["Experiment"]["properties"][key]
        columns["additionalProperties"] = {"anyOf": [{"type": "string"}, columns["additionalProperties"]]}
    return schema
