"""Canonical texts of run specs that differ only in a few numbers, and their hashes, without the specs themselves."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np
from pydantic import BaseModel

from mbdkit.base.plain_data import Path, canonical_text
from mbdkit.spec.run_spec import RunSpec


class UnknownTextError(Exception):
    """The texts of specs cannot be made from a template."""


def path_in(data: Any, path: Path) -> Path:
    """Return a key path with integers as indices of lists; raises LookupError, TypeError or ValueError if the
    data lack it.
    """
    keys: list[str | int] = []
    for key in path:
        keys.append(int(key) if isinstance(data, list) else key)
        data = data[keys[-1]]
    return tuple(keys)


class SpecTexts:
    """The canonical JSON of specs that differ only in the numbers at some key paths.

    Raises
    ------
    UnknownTextError
        If a number is not in the text, or if its text depends on more than the number.
    """

    def __init__(self, spec: RunSpec, paths: Sequence[Path]):
        text = spec.canonical_json()
        data = json.loads(text)
        if canonical_text(data) != text:
            raise UnknownTextError
        self._kinds, self._defaults = [], [_default(spec, path) for path in paths]
        for number, path in enumerate(paths):
            holder: Any = data
            try:
                for key in path[:-1]:
                    holder = holder[key]
                self._kinds.append(type(holder[path[-1]]))
            except LookupError as error:
                raise UnknownTextError from error
            holder[path[-1]] = f"\0{number}\0"
        if not {*self._kinds} <= {int, float}:
            raise UnknownTextError
        template = canonical_text(data)
        marks = [json.dumps(f"\0{number}\0") for number in range(len(paths))]
        self._order = sorted(range(len(paths)), key=lambda number: template.index(marks[number]))
        self._parts: list[str] = []
        for number in self._order:
            before, _, template = template.partition(marks[number])
            self._parts.append(before)
        self._end = template
        self._used = "\n".join(["", *(f"{item.id}=={item.origin.version}" for item in spec.items)]).encode()

    def are_known(self, columns: Sequence[np.ndarray]) -> np.ndarray:
        """Return whether the texts of specs with these values, K columns (N,), can be made, (N,).

        Keys with default values may be absent from a text.
        """
        known = np.ones(len(columns[0]), dtype=bool)
        for column, kind, default in zip(columns, self._kinds, self._defaults, strict=True):
            known &= np.isfinite(column) & (column != 0.0) & (column != default)
            if kind is int and column.dtype.kind != "i":
                known[:] = False
        return known

    def hashes(self, columns: Sequence[np.ndarray]) -> tuple[list[str], list[str]]:
        """Return `RunSpec.sha256` and `RunSpec.run_id` of the specs with these values, K columns (N,)."""
        texts: list[Iterable[str]] = []
        for number, before in zip(self._order, self._parts, strict=True):
            convert = float.__repr__ if self._kinds[number] is float else int.__repr__
            values = columns[number].astype(self._kinds[number]).tolist()
            texts.append([before + convert(value) for value in values])
        specs, runs = [], []
        for parts in zip(*texts, strict=True):
            digest = sha256(("".join(parts) + self._end).encode())
            specs.append(digest.hexdigest())
            digest.update(self._used)
            runs.append(digest.hexdigest()[:16])
        return specs, runs


def _default(spec: RunSpec, path: Path) -> float:
    """Return the default value of the number at a path; nan if it has none."""
    holder: Any = spec
    default: Any = np.nan
    for key in path:
        if isinstance(holder, BaseModel):
            field = type(holder).model_fields.get(str(key))
            if field is None:
                raise UnknownTextError
            default, holder = field.default, getattr(holder, str(key))
        elif isinstance(holder, Mapping | list | tuple):
            try:
                holder = holder[key]  # type: ignore[index]
            except LookupError as error:
                raise UnknownTextError from error
            is_item = isinstance(key, int) and isinstance(default, list | tuple) and len(default) > key
            default = default[key] if is_item else np.nan
        else:
            raise UnknownTextError
    return float(default) if isinstance(default, int | float) else np.nan
