"""The parameters with respect to which a run is differentiated: named parameters and numbers of the model."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, path_text, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.parameters import names_in
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import parse_key

MOST_PARAMETERS = 50
"""Largest number of parameters of one gradient."""


@dataclass(frozen=True)
class Parameter:
    """A number of a spec.

    Parameters
    ----------
    name
        Name of the parameter as given by the user.
    path
        Key path of the number in the spec.
    value
        Value of the number.
    """

    name: str
    path: Path
    value: float


def resolved(spec: ModelSpec, names: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters with these names: keys of `parameters`, or key paths that begin with ``model.``.

    Raises
    ------
    SpecError
        If a parameter does not exist, is not a number of the model or is named twice, or if there are none or too many.
    """
    if isinstance(names, str):
        names = [names]
    if not names:
        raise SpecError("a gradient needs at least one parameter", key="gradients")
    if len(names) > MOST_PARAMETERS:
        raise SpecError(f"a gradient takes at most {MOST_PARAMETERS} parameters, not {len(names)}", key="gradients")
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        raise SpecError(f"the parameter '{twice[0]}' is named twice", key="gradients")
    data = json.loads(spec.canonical_json())
    return tuple(_resolved(spec, data, name) for name in names)


def _resolved(spec: ModelSpec, data: dict[str, Any], name: str) -> Parameter:
    if name in spec.parameters:
        value = spec.parameters[name]
        if isinstance(value, str):
            contained = names_in(value) & spec.parameters.keys()
            way = "use the parameters that it contains" if contained else "write its value as a number"
            raise _refused(f"'{name}' is the expression '{value}'; {way}")
        return Parameter(name, ("parameters", name), float(value))
    path = parse_key(name)
    if path[:1] == ("parameters",) and len(path) == 2:
        return _resolved(spec, data, str(path[1])) if path[1] in spec.parameters else _unknown(spec, name)
    if len(path) < 2:
        return _unknown(spec, name)
    if path[0] != "model":
        raise _refused(
            f"'{name}' cannot be a parameter of a gradient; give the name of one of the `parameters` or the key of "
            f"a number of `model`"
        )
    holder: Any = data
    for i, key in enumerate(path):
        part = int(key) if isinstance(holder, list) and str(key).isdecimal() else key
        known = (
            list(range(len(holder))) if isinstance(holder, list) else list(holder) if isinstance(holder, dict) else []
        )
        if part not in known:
            where = path_text(path[:i])
            hint = did_you_mean(str(part), [one for one in known if isinstance(one, str)])
            raise _refused(f"the spec has no key '{name}': there is no '{part}' in {where}{hint}")
        holder = holder[part]
    if isinstance(holder, str):
        raise _refused(f"'{name}' is the text or expression '{holder}', not a number; name a parameter in it")
    if isinstance(holder, bool) or not isinstance(holder, int | float):
        raise _refused(f"'{name}' should be the key of a number, not of {value_text(holder)}")
    return Parameter(name, path, float(holder))


def _unknown(spec: ModelSpec, name: str) -> Parameter:
    known = list(spec.parameters)
    text = f"; parameters: {listed(known)}" if known else "; the spec has no `parameters`"
    hint = did_you_mean(name, known) or text
    raise _refused(
        f"there is no parameter '{name}'{hint}. Numbers of the model have key paths, such as model.bodies.rod.mass"
    )


def _refused(message: str) -> SpecError:
    return SpecError(message, key="gradients")
