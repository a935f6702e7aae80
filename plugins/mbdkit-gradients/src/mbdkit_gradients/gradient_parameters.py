"""The parameters with respect to which a run is differentiated: named parameters and numbers of the model."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, path_text, plain, value_text
from mbdkit.base.text import did_you_mean, listed
from mbdkit.mechanism.parameters import names_in
from mbdkit.spec.loading import read_source
from mbdkit.spec.model_spec import ModelSpec
from mbdkit.spec.reading import parse_key, put

#: One name, several names, or names with the values of their parameters.
Names = str | Iterable[str] | Mapping[str, float | str]


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


def read_names(
    source: object, names: object, parameters: object, sections: dict[str, object]
) -> tuple[object, list[str]]:
    """Return the source of a spec, with the values of parameters if `names` is a mapping, and the names as a list.

    If there are no names, `parameters` are the names; else they are added to the `sections`, and values of `names`
    replace theirs.

    Raises
    ------
    SpecError
        If the names are anything else than names, or for values: see `_put_values`.
    """
    if names is None:
        names, parameters = parameters, None
    result = [names] if isinstance(names, str) or not isinstance(names, Iterable) else list(names)
    for name in result:
        if not isinstance(name, str):
            text = "None" if name is None else value_text(name)
            raise refused(
                f"a gradient needs names of parameters, such as 'stiffness' or 'model.bodies.rod.mass', not {text}"
            )
    if parameters is not None:
        sections["parameters"] = plain(parameters, ("parameters",))
    if isinstance(names, Mapping):
        source = read_source(source)
        _put_values(source.data if parameters is None else sections, names)
    return source, [str(name) for name in result]  # NumPy has its own type of text


def _put_values(data: dict[str, Any], values: Mapping[str, object]) -> None:
    """Change the values of named parameters in the section `parameters` of a spec.

    Raises
    ------
    SpecError
        If a key is a key path, if a name is not one of the parameters of the spec (in a spec without parameters, if no
        expression contains it), or if a value is not plain data.
    """
    parameters = data.get("parameters")
    known = list(parameters) if isinstance(parameters, dict) else sorted(names_in(data))
    for name, value in values.items():
        path = parse_key(name)
        if path[:1] == ("model",) and len(path) > 1:
            raise refused(f"the value of '{name}' cannot be given here, only its name; change the spec instead")
        path = ("parameters", *path[path[:1] == ("parameters",) :])
        if len(path) != 2 or path[1] not in known:
            raise _unknown(known if isinstance(parameters, dict) else [], name)
        put(data, path, plain(value, path))


def resolved(spec: ModelSpec, names: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters with these names: keys of `parameters`, or key paths that begin with ``model.``.

    Raises
    ------
    SpecError
        If a parameter does not exist, is not a number of the model or is named twice, or if there are none.
    """
    if not names:
        raise refused("a gradient needs at least one parameter")
    data = json.loads(spec.canonical_json())
    results = [_resolved(spec, data, name) for name in names]
    seen = set[Path]()
    for result in results:
        if result.path in seen:
            raise refused(f"the parameter '{result.name}' is named twice")
        seen.add(result.path)
    return tuple(results)


def _resolved(spec: ModelSpec, data: dict[str, Any], name: str) -> Parameter:
    if name in spec.parameters:
        value = spec.parameters[name]
        if isinstance(value, str):
            contained = names_in(value) & spec.parameters.keys()
            way = "use the parameters that it contains" if contained else "write its value as a number"
            raise refused(f"'{name}' is the expression '{value}'; {way}")
        return Parameter(name, ("parameters", name), float(value))
    path = parse_key(name)
    is_named = path[:1] == ("parameters",) and len(path) == 2
    if is_named and path[1] in spec.parameters:
        return _resolved(spec, data, str(path[1]))
    if is_named or len(path) < 2:
        raise _unknown(list(spec.parameters), name)
    if path[0] != "model":
        raise refused(
            f"'{name}' is no parameter of the mechanism; give the name of one of the `parameters` or the key of "
            f"a number of `model`"
        )
    holder: Any = data
    for i, key in enumerate(path):
        part = int(key) if isinstance(holder, list) and str(key).isdecimal() else key
        known = range(len(holder)) if isinstance(holder, list) else holder if isinstance(holder, dict) else ()
        if part not in known:
            where = path_text(path[:i])
            hint = did_you_mean(str(part), [one for one in known if isinstance(one, str)])
            raise refused(f"the spec has no key '{name}': there is no '{part}' in {where}{hint}")
        holder = holder[part]
    if isinstance(holder, str):
        raise refused(f"'{name}' is the text or expression '{holder}', not a number; name a parameter in it")
    if isinstance(holder, bool) or not isinstance(holder, int | float):
        raise refused(f"'{name}' should be the key of a number, not of {value_text(holder)}")
    return Parameter(name, path, float(holder))


def _unknown(known: list[str], name: str) -> SpecError:
    text = f"; parameters: {listed(known)}" if known else "; the spec has no `parameters`"
    hint = did_you_mean(name, known) or text
    return refused(
        f"there is no parameter '{name}'{hint}. Numbers of the model have key paths, such as model.bodies.rod.mass"
    )


def refused(message: str) -> SpecError:
    """Return an error about the parameters of a gradient."""
    return SpecError(message, key="gradients")
