"""Reading of spec files in YAML, JSON or TOML, and of assignments on the command line, into documents."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any

from mbdkit.base.errors import SpecError
from mbdkit.base.files import read_bytes
from mbdkit.base.files_read import FilesRead
from mbdkit.base.plain_data import (
    DEEPEST,
    QUOTED,
    Path,
    assignment_parts,
    copied,
    json_data,
    parse_path,
    path_text,
    value_text,
    without_collection,
)
from mbdkit.base.text import did_you_mean, listed
from mbdkit.spec.yaml_reader import LARGEST, read_data, read_yaml


@dataclass
class Document:
    """Plain data and its origin.

    - `file`: name of the file that the data were read from; empty for data from Python.
    - `lines`: function that returns the line numbers of key paths; called only if there is an error to locate.
    - `overridden`: key paths set on the command line, with the text of each assignment.
    - `keywords`: top-level sections replaced by Python keyword arguments.
    - `folder`: folder to which file names in the data are relative; by default, the current folder.
    - `files`: files that were read for the data.
    """

    data: dict[str, Any]
    file: str = ""
    lines: Callable[[], Mapping[Path, int]] = dict
    overridden: dict[Path, str] = field(default_factory=dict)
    keywords: frozenset[str] = frozenset()
    folder: FilePath = FilePath()
    files: FilesRead = field(default_factory=FilesRead)

    @without_collection()
    def place(self, error: SpecError) -> SpecError:
        """Return the error with the file and line of its key, or with the command-line assignment that set the key."""
        if error.file is not None:
            return error
        path = parse_path(error.key)
        assigned = {tuple(map(str, key)): text for key, text in self.overridden.items()}  # `angles.0` and `angles[0]`
        for length in range(len(path), 0, -1):
            if text := assigned.get(tuple(map(str, path[:length]))):
                return error.located(file=f"--set {text}")
        if self.file and path and path[0] in self.keywords:
            return error.located(file=f"keyword {path[0]}")
        if not self.file or error.line is not None:
            return error.located(file=self.file or None)
        lines = self.lines()
        nearest = next((lines[path[:length]] for length in range(len(path), 0, -1) if path[:length] in lines), None)
        return error.located(file=self.file, line=nearest)

    def assign(self, assignment: str) -> None:
        """Set a key according to an assignment ``key.path=value`` from the command line.

        Raises SpecError if the text is not an assignment, if the value is not YAML, or if the key path does not fit the
        document.
        """
        path, value = read_assignment(assignment)
        where = f"--set {assignment}"
        with SpecError.place_by(lambda error: error.located(file=where)):
            put(self.data, path, value)
        self.overridden[path] = assignment


LARGEST_FILE = 16 * 2**20  # bytes
STDIN = "<stdin>"


def read_file(path: FilePath) -> Document:
    """Read a file: JSON or TOML if its suffix is ``.json`` or ``.toml``, otherwise YAML.

    Raises SpecError if the file is not a spec, with the file name and, if known, the line. Raises ResourceError if the
    system refuses to read the file.
    """
    file = str(path)
    if os.path.isdir(path):
        raise SpecError("this is a folder; a spec is a YAML, TOML or JSON file", file=file)
    document = read_text(_decoded(read_bytes(path, LARGEST_FILE), file), file, path.suffix.lower())
    document.folder = path.parent
    return document


def read_stdin() -> Document:
    """Read a document in YAML or JSON from standard input."""
    return read_text(_decoded(sys.stdin.buffer.read(LARGEST_FILE + 1), STDIN), STDIN)


@without_collection()
def read_text(text: str, file: str, suffix: str = ".yaml") -> Document:
    """Parse the text of a document.

    `file`: origin of the text, for error messages. `suffix`: ``.json`` or ``.toml``; any other suffix means YAML.
    """
    _check_size(text, suffix, file)
    with SpecError.place_by(lambda error: error.located(file=file)):
        match suffix:
            case ".json":
                data, document = _parsed(text, "JSON", _json), Document({}, file, lambda: read_yaml(text)[1])
            case ".toml":
                data, document = _parsed(text, "TOML", _toml), Document({}, file, lambda: _toml_lines(text))
            case _:
                data, document = read_data(text), Document({}, file, lambda: read_yaml(text)[1])
    if data is None:
        raise SpecError("this file is empty; a spec begins with `mbdkit: 1`", file=file)
    if not isinstance(data, Mapping):
        raise SpecError(
            f"a spec should be a mapping (`key: value`) at the top level, not {value_text(data)}", file=file, line=1
        )
    with SpecError.place_by(lambda error: error.located(file=file)):
        document.data = copied(data)  # also checks the depth
    return document


#: Characters by which the values of a document are counted: there is at least one of them for each value.
#:
#: In YAML, the characters are commas and line breaks, and this is true for ordinary documents only.
_SEPARATORS = {".json": ",:[{", ".toml": ",=[{."}


def _check_size(text: str, suffix: str, file: str) -> None:
    """Raise SpecError if a document has too many values; counting separators is cheaper than parsing."""
    if len(text) > LARGEST_FILE:
        raise SpecError(f"this is larger than {LARGEST_FILE >> 20} MiB, the limit for a spec", file=file)
    if sum(text.count(separator) for separator in _SEPARATORS.get(suffix, ",\n")) > LARGEST:
        raise SpecError(f"this is too large: more than {LARGEST} values", file=file)


def _decoded(raw: bytes, file: str) -> str:
    if raw.startswith(b"\x89HDF"):
        raise SpecError(
            "this is an HDF5 file, not a spec; `mbdkit.load` reads an archive, and `mbdkit rerun` runs its spec again",
            file=file,
        )
    if len(raw) > LARGEST_FILE:
        raise SpecError(f"this file is larger than {LARGEST_FILE >> 20} MiB, the limit for a spec", file=file)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        raise SpecError("this file is not valid UTF-8 text", file=file, line=line) from None
    if control := re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]", text):
        line = text[: control.start()].count("\n") + 1
        raise SpecError(f"there is a control character {control[0]!r} here; is this a text file?", file=file, line=line)
    return text


def _parsed(text: str, word: str, parse: Callable[[str], object]) -> object:
    """Return the data of a text in the format of this name; None if it is empty."""
    try:
        return parse(text) if text.strip() else None
    except RecursionError:
        raise SpecError(f"this {word} is nested too deeply") from None
    except ValueError as error:  # for example, an integer with thousands of digits
        raise error if isinstance(error, SpecError) else _invalid(word, str(error)) from None


def _invalid(word: str, problem: str, line: int | None = None) -> SpecError:
    return SpecError(f"this is not valid {word}: {problem[:1].lower()}{problem[1:]}", line=line)


def _json(text: str) -> object:
    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        result: dict[str, object] = {}
        for key, value in pairs:
            if key in result:
                raise SpecError(f"the key '{key}' occurs twice in one object")
            result[key] = value
        return result

    try:
        return json_data(text, object_pairs_hook=unique)
    except json.JSONDecodeError as error:
        raise _invalid("JSON", f"{error.msg} (column {error.colno})", error.lineno) from None


_WORD = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
#: A dotted key with too many parts; time and memory for reading it would be quadratic in its length.
_DEEP_KEY = re.compile(rf"(?<![\w.-]){_WORD}(?:[ \t]*+\.[ \t]*+{_WORD}){{{DEEPEST}}}")


def _toml(text: str) -> object:
    if _DEEP_KEY.search(text):
        raise SpecError(f"this TOML is nested too deeply: a key of more than {DEEPEST} parts")
    import tomllib

    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        where = re.search(r" \(at line (\d+), column \d+\)", str(error))
        problem = str(error).replace(where[0], "") if where else str(error)
        raise _invalid("TOML", problem, int(where[1]) if where else None) from None


def _toml_lines(text: str) -> dict[Path, int]:
    """Return the line number of each key at the start of a line; keys inside inline tables have no line number."""
    lines: dict[Path, int] = {}
    table: Path = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*+\[\[?+([^\]]++)\]", line)
        entry = re.match(rf"\s*+({_WORD}(?:\s*+\.\s*+{_WORD})*+)\s*+=", line)
        if header:
            table = _toml_key(header[1])
            lines.setdefault(table, number)
        elif entry:
            lines.setdefault(table + _toml_key(entry[1]), number)
    return lines


def _toml_key(text: str) -> Path:
    words = re.findall(r"""[\w-]+|"[^"]*"|'[^']*'""", text)
    return tuple(word.strip("\"'") for word in words)


def read_assignment(assignment: str) -> tuple[Path, object]:
    """Return the key path and the value of an assignment ``key.path=value`` from the command line.

    Raises SpecError if the text is not an assignment, or if the value is not YAML.
    """
    where = f"--set {assignment}"
    key, equals, text = assignment_parts(assignment)
    path = parse_key(key.strip())
    if not equals or not path:
        raise SpecError("should have the form KEY=VALUE, such as time.step=0.005", file=where)
    try:
        return path, read_data(text)
    except SpecError as error:
        raise SpecError(error.message, key=key.strip(), file=where) from None


def put(data: dict[str, Any], path: Path, value: object) -> None:
    """Set the value at `path` in plain data; missing mappings along the path are created, except elements.

    Items of a list that is missing become a mapping such as ``{"0": 0.1}``, which validation replaces by the default
    list with these items.

    Raises SpecError if a value along the path is not a mapping or list with the next key, or if it is a mapping of
    other elements.
    """
    holder: Any = data
    for index, part in enumerate(path):
        last = index == len(path) - 1
        if isinstance(holder, list) and isinstance(part, str) and re.fullmatch(r"\d{1,9}", part):
            part = int(part)  # as in `model.angles.0`
        elif isinstance(part, int) and holder is not data and are_items(holder):
            part = str(part)  # of a list that is missing, which the spec itself is not
        if isinstance(holder, list) and isinstance(part, int):
            if part >= len(holder):
                here = path_text(path[:index]) or "the spec"
                raise SpecError(f"{here} has {len(holder)} items, counted from 0", key=path_text(path))
        elif isinstance(holder, dict) and isinstance(part, str):
            if not last and holder.get(part) is None:
                _refuse_other_element(holder, path, index)
                holder[part] = {}
        else:
            here = path_text(path[:index]) or "the spec"
            raise SpecError(f"{here} is {value_text(holder)}, so it has no '{part}'", key=path_text(path))
        if last:
            holder[part] = value
        else:
            holder = holder.get(part) if isinstance(holder, dict) else holder[part]


def are_items(data: object) -> bool:
    """Return whether data are a mapping that contains nothing but items of a list by index."""
    return isinstance(data, dict) and all(re.fullmatch(r"0|[1-9]\d{0,8}", key) for key in data)


def _refuse_other_element(elements: Mapping[str, object], path: Path, index: int) -> None:
    """Refuse a path to one key of an element that does not exist, whose name is probably misspelt.

    The mapping at ``path[:index]`` contains `elements`, such as bodies or loads, if all of its values are mappings.
    """
    is_named = (index == 2 and path[0] == "model") or path[:index] in (("events",), ("loads",), ("motion", "columns"))
    if is_named and elements and all(isinstance(element, Mapping) for element in elements.values()):
        name, here = str(path[index]), path_text(path[:index])
        known = did_you_mean(name, map(str, elements)) or f" (it has {listed(map(str, elements), most=12)})"
        raise SpecError(
            f"{here} has no '{name}'{known}; to add it, give all its keys at once, as in "
            f"{path_text(path[: index + 1])}={{...}}",
            key=path_text(path),
        )


@lru_cache(maxsize=1024)
def variable_path(name: str) -> Path:
    """Return the key path that a variable sets; a name without dots refers to a parameter."""
    path = parse_key(name)
    return path if len(path) > 1 else ("parameters", *path)


def parse_key(key: str) -> Path:
    """Return the parts of a dotted key; an empty tuple if it is not valid, or has more parts than any spec allows."""
    bare = re.sub(QUOTED, "name", key)
    path = () if not key or ".." in f".{bare}." else parse_path(key)
    return path if len(path) <= DEEPEST else ()
