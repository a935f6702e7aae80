"""Canonical texts of run specs that differ only in a few numbers, and their hashes, without the specs themselves."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from typing import Any

import numpy as np
from pydantic import BaseModel

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import Path, canonical_text, path_text
from mbdkit.spec.run_spec import RunSpec


class SpecTexts:
    """The canonical JSON of specs that differ only in the numbers at some key paths.

    Parameters
    ----------
    spec
        One of the specs.
    keys
        The key paths; indices of lists may be texts, as in ``model.angles.0``.

    Attributes
    ----------
    paths
        The key paths with integers as indices.

    Raises
    ------
    SpecError
        If a number is not in the text, or if its text depends on more than the number.
    """

    def __init__(self, spec: RunSpec, keys: Sequence[Path]):
        text = spec.canonical_json()
        data = json.loads(text)
        if canonical_text(data) != text:
            raise SpecError("the text of the spec is not canonical")
        self.paths = [_path_in(data, key) for key in keys]
        self._kinds, self._defaults = [], [_default(spec, path) for path in self.paths]
        for number, path in enumerate(self.paths):
            holder: Any = data
            for key in path[:-1]:
                holder = holder[key]
            self._kinds.append(type(holder[path[-1]]))
            holder[path[-1]] = f"\0{number}\0"
        if not {*self._kinds} <= {int, float}:
            raise SpecError("a value is no number")
        template = canonical_text(data)
        marks = [json.dumps(f"\0{number}\0") for number in range(len(keys))]
        self._order = sorted(range(len(keys)), key=lambda number: template.index(marks[number]))
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
            if (field := type(holder).model_fields.get(str(key))) is None:
                raise _unknown(path)
            default, holder = field.default, getattr(holder, str(key))
        elif isinstance(holder, Mapping | list | tuple):
            try:
                holder = holder[key]  # type: ignore[index]
            except LookupError as error:
                raise _unknown(path) from error
            is_item = isinstance(key, int) and isinstance(default, list | tuple) and len(default) > key
            default = default[key] if is_item else np.nan
        else:
            raise _unknown(path)
    return float(default) if isinstance(default, int | float) else np.nan


def _path_in(data: Any, path: Path) -> Path:
    """Return a key path with integers as indices of lists."""
    keys: list[str | int] = []
    for key in path:
        try:
            keys.append(int(key) if isinstance(data, list) else key)
            data = data[keys[-1]]
        except (LookupError, TypeError, ValueError) as error:
            raise _unknown(path) from error
    return tuple(keys)


def _unknown(path: Path) -> SpecError:
    return SpecError("the text of the spec lacks this number", key=path_text(path))
