"""Print the types that an OpenSim model may contain, their properties and the default values of these, as JSON.

Needs the package `opensim`. ``python -m tests.benchmarks.registry_of_opensim`` prints the file
``plugins/mbdkit-opensim/src/mbdkit_opensim/registry.json``.
"""

from __future__ import annotations

import json
from typing import Any

import opensim

KINDS = ("Actuator", "Muscle", "Force", "Joint", "Constraint", "Controller", "Function", "Component")
"""Base classes, the most special first; a type is listed below the first of these from which it is derived."""


def default_of(value: Any) -> str:
    """Return the default of a property as OpenSim writes it, or the class of its objects after a colon."""
    text = value.toString().strip("()")
    return f":{value.getTypeName()}" if value.isObjectProperty() else text


def main() -> None:
    opensim.Logger.setLevelString("off")
    names = opensim.ArrayStr()
    opensim.OpenSimObject.getRegisteredTypenames(names)
    every = {name: opensim.OpenSimObject.newInstanceOfType(name) for name in map(names.get, range(names.getSize()))}
    types: dict[str, dict[str, dict[str, str]]] = {kind: {} for kind in (*KINDS, "Other")}
    for name, item in sorted(every.items()):
        kind = next((kind for kind in KINDS if getattr(opensim, kind).safeDownCast(item)), "Other")
        if kind == "Actuator" and opensim.Muscle.safeDownCast(item):
            kind = "Muscle"
        properties = map(item.getPropertyByIndex, range(item.getNumProperties()))
        types[kind][name] = {value.getName(): default_of(value) for value in properties}
    others, types["Other"] = types["Other"], {}
    for kind in (*KINDS, *["Other"] * 3):  # objects of objects are three deep at most
        classes = {default[1:] for of in types[kind].values() for default in of.values() if default.startswith(":")}
        types["Other"] = {name: of for name, of in others.items() if name in classes or name in types["Other"]}
    rows = [
        f' "{kind}": {{\n' + ",\n".join(f'  "{name}": {json.dumps(of)}' for name, of in types[kind].items()) + "\n }"
        for kind in types
    ]
    source = f"registry of OpenSim {opensim.GetVersion()}, PyPI package opensim"
    print(f'{{\n "source": "{source}",\n' + ",\n".join(rows) + "\n}")


if __name__ == "__main__":
    main()
