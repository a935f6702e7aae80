"""Specs of many runs that differ in a few values; parts that do not depend on these values are validated once."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import chain

from pydantic import ValidationError

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, canonical, copied, path_text, plain
from mbdkit.base.text import did_you_mean
from mbdkit.mechanism.impure_items import impure_item_of
from mbdkit.mechanism.parameters import names_in, parameter_values, without_units
from mbdkit.spec.choices import RegistryLookup, registry_of
from mbdkit.spec.reading import put
from mbdkit.spec.run_spec import RunSpec

MOST_ALIKE = 8  #: Largest number of models that are kept.


class VariedSpecs:
    """Makes run specs from a base by setting values in it.

    If the values are options of the model, or numbers for named parameters, only the model is validated again, because
    no other section of a valid spec depends on them. The whole spec is validated for other values, if the model refuses
    a value, if the spec has `accuracy`, for items of lists that the base leaves at their defaults, and for options of
    the model if it has `parameters` or expressions. Errors are raised by the validation of the whole spec.

    `base`: the spec before the values are set, as JSON. `alike`: the latest specs by their models as JSON, for bases
    that share them because they have equal models and parameters.
    """

    def __init__(self, base: str, alike: dict[str, RunSpec] | None = None):
        self._base: dict[str, object] = json.loads(base)
        self._alike = {} if alike is None else alike
        self._pattern: RunSpec | None = None
        self._expressed: RunSpec | None = None
        self._template: tuple[tuple[Path, ...], Callable[[Sequence[object]], str]] | None = None
        self._context = {"plugins": RegistryLookup(lambda: registry_of(RunSpec))}

    def spec(self, values: Sequence[tuple[Path, object]]) -> RunSpec:
        """Return the spec with these values at their key paths.

        Raises SpecError if the spec is not valid, or if a value is that of an unknown parameter.
        """
        in_model = all(path[:1] == ("model",) and len(path) > 1 and path[1] != "name" for path, _ in values)
        if self._pattern is not None and in_model:
            try:
                return self._with_values(self._pattern, values)
            except Exception:
                self._pattern = None  # until the next valid spec
        elif self._expressed is not None and values and all(map(self._is_parameter, values)):
            with suppress(SpecError, ValidationError, LookupError, TypeError):  # the whole spec has the right words
                return self._with_parameters(self._expressed, values)
        data = copied(self._base)
        for path, value in values:
            put(data, path, value)
        spec = RunSpec(**data)
        self._check_parameters(spec, values)
        if in_model and not spec.parameters and not spec.written and spec.accuracy is None:
            self._pattern = spec
        if spec.accuracy is None and all(map(self._is_parameter, values)) and not in_model:
            self._expressed = spec
        return spec

    def _is_parameter(self, one: tuple[Path, object]) -> bool:
        """Return whether a number is set for a named parameter of the base."""
        (path, value), given = one, self._base.get("parameters")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        return is_number and len(path) == 2 and path[0] == "parameters" and isinstance(given, dict) and path[1] in given

    def _with_parameters(self, pattern: RunSpec, values: Sequence[tuple[Path, object]]) -> RunSpec:
        """Return a valid spec with other numbers for named parameters."""
        parameters: dict[str, float | str] = without_units(self._base["parameters"])  # type: ignore[arg-type]
        for path, value in values:
            assert isinstance(value, int | float)
            parameters[str(path[1])] = float(value)
        numbers = parameter_values(parameters)
        changed = {name for name, value in numbers.items() if value != pattern.numbers[name]}
        data = {"model": canonical(pattern.model)}
        for path, written in pattern.written.items():
            if not changed.isdisjoint(names_in(written)):
                put(data, path, written.value(numbers, path))
        text = json.dumps(data["model"], allow_nan=False)
        if (known := self._alike.get(text)) is None:
            model = type(pattern.model).model_validate_json(text, context=self._context)
            found = pattern.with_model(model, parameters, numbers)
            if impure_item_of(found) is None:
                self._alike[text] = found
            if len(self._alike) > MOST_ALIKE:
                self._alike.pop(next(iter(self._alike)))
            return found
        found = pattern.with_model(known.model, parameters, numbers)
        found.adopt(known.mechanism(), known._files)
        return found

    def _check_parameters(self, spec: RunSpec, values: Sequence[tuple[Path, object]]) -> None:
        """Raise SpecError for a parameter that is set, but neither defined in the base nor used by an expression."""
        given = self._base.get("parameters")
        known = given if isinstance(given, dict) else {}
        for path, _ in values:
            if path[0] == "parameters" and len(path) > 1 and path[1] not in {*known, *spec.used_parameters()}:
                hint = did_you_mean(str(path[1]), known)
                raise SpecError(f"the spec has no such parameter, and no expression uses it{hint}", key=path_text(path))

    def _with_values(self, pattern: RunSpec, values: Sequence[tuple[Path, object]]) -> RunSpec:
        paths = tuple([path for path, _ in values])
        if self._template is None or self._template[0] != paths:
            self._template = paths, self._text_with(paths)
        text = self._template[1]([value for _, value in values])
        return pattern.with_model(type(pattern.model).model_validate_json(text, context=self._context))

    def _text_with(self, paths: tuple[Path, ...]) -> Callable[[Sequence[object]], str]:
        """Return a function that returns the JSON of the model with values at these paths.

        Everything but the values is converted to JSON only once.
        """
        model = self._base["model"]
        marks = [f"\0value {number}\0" for number in range(len(paths))]
        data = {"model": copied(model)}
        for path, mark in zip(paths, marks, strict=True):
            put(data, path, mark)  # raises SpecError if another path leads to a part of this value
        text = json.dumps(plain(data["model"]), allow_nan=False)
        places = [text.index(json.dumps(mark)) for mark in marks]  # raises ValueError if a path occurs twice
        order = sorted(range(len(paths)), key=places.__getitem__)
        fixed, encode = [], json.JSONEncoder(allow_nan=False).encode
        for number in order:
            before, _, text = text.partition(json.dumps(marks[number]))
            fixed.append(before)

        def filled(values: Sequence[object]) -> str:
            texts = [encode(plain(values[number], paths[number])) for number in order]
            return "".join([*chain.from_iterable(zip(fixed, texts, strict=True)), text])

        return filled
