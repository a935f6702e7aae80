"""The JSON schema of the run spec, for editors and other tools."""

from __future__ import annotations

import json
from typing import Any

from mbdkit.registry.catalogue import Registry
from mbdkit.registry.manager import registry
from mbdkit.spec.run_spec import spec_type

HOME = "https://raw.githubusercontent.com/mbdkit/mbdkit/main/schemas/run.schema.json"


def run_schema(installed: Registry | None = None) -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of the run spec.

    Parameters
    ----------
    installed
        The models and integrators to put in; by default all that are installed.
    """
    schema = spec_type(installed if installed is not None else registry()).model_json_schema()
    schema["description"] = schema["description"].partition("\n\nRaises")[0]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def builtin_schema_text() -> str:
    """Return the text of ``schemas/run.schema.json``: the schema with the models and integrators of mbdkit alone."""
    schema = run_schema(registry().only("mbdkit"))
    return json.dumps({"$schema": schema.pop("$schema"), "$id": HOME, **schema}, indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    print(builtin_schema_text(), end="")
