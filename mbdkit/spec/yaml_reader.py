"""Reading of YAML 1.2 as plain data with line numbers; rejects object tags, duplicate keys and alias bombs.

libyaml splits the text into events, from which this module builds the data. Limits are checked before large data are
created, and scalars have the types of YAML 1.2.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import yaml
from yaml.events import (
    AliasEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
)

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import DEEPEST, LARGEST_NUMBER, Path, path_text

LARGEST = 500_000  # values, after expansion of aliases
LONGEST = 16 * 2**20  # characters of all scalars together, after expansion of aliases
TOO_DEEP = f"this YAML is nested too deeply: more than {DEEPEST} levels"

CORE = "tag:yaml.org,2002:"
IMPLICIT = ("null", "bool", "int", "float", "timestamp", "merge", "value")
CONSTANTS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
WHOLE = re.compile(r"[-+]?[0-9]+")
OTHER_BASE = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")

#: Hints by the character at which the text cannot be read. The words of libyaml change from version to version.
HINTS = {
    ":": " (is the line indented too far, or does a text with a colon need quotes?)",
    **dict.fromkeys("@`%", " (put the text in quotes)"),
}

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DUMPER: Any = yaml.SafeDumper


def read_yaml(text: str) -> tuple[Any, dict[Path, int]]:
    """Parse YAML; return the plain data and the line number of each key path, counted from 1.

    `text`: one YAML document; None is returned for an empty document. Raises SpecError if the text is not YAML, or not
    plain data. The error has the line number.
    """
    reader = _Reader(text, {})
    return reader.document(), reader.lines


def read_data(text: str) -> Any:
    """Parse YAML as `read_yaml` does, without line numbers, which takes less time and memory."""
    return _Reader(text, None).document()


class _Reader:
    """Builds plain data from events.

    `count` is the number of values so far, and `length` the number of characters of all scalars so far,
    both after expansion of aliases.
    """

    def __init__(self, text: str, lines: dict[Path, int] | None):
        self.text = text
        self.loader = _LOADER(text)
        self.next: Callable[[], Event] = self.loader.get_event
        self.has_lines, self.lines = lines is not None, lines or {}
        self.placed: list[Path] = []
        self.count = self.length = 0
        self.anchors: dict[str, tuple[object, int, int, Path, slice]] = {}
        self.open: set[str] = set()

    def document(self) -> object:
        """Return the data of the only document; None if there is none."""
        data: object = None
        documents = 0
        try:
            while not isinstance(event := self.next(), StreamEndEvent):
                if isinstance(event, DocumentStartEvent):
                    documents += 1
                    if documents > 1:
                        message = "a second YAML document begins here; a spec is a single document"
                        raise SpecError(message, line=event.start_mark.line + 1)
                    data = self.value(self.next(), ())
        except yaml.MarkedYAMLError as error:
            raise _syntax(error, self.text) from None
        except (yaml.YAMLError, ValueError) as error:
            if isinstance(error, SpecError):
                raise
            problem = next(iter(str(error).splitlines()), type(error).__name__)
            raise SpecError(f"this is not valid YAML: {problem}") from None
        finally:
            self.loader.dispose()
        return data

    def value(self, event: Event, path: Path) -> object:
        """Return the value that begins with an event."""
        if isinstance(event, AliasEvent):
            return self._alias(event, path)
        before = self.count, self.length, len(self.placed)
        self._add(1, 0, event, path)
        if (anchor := event.anchor) is not None:
            self.anchors.pop(anchor, None)
            self.open.add(anchor)
        data = self._new(event, path)
        if anchor is not None:
            self.open.discard(anchor)
            below = slice(before[2], len(self.placed))
            self.anchors[anchor] = (data, self.count - before[0], self.length - before[1], path, below)
        return data

    def _new(self, event: Event, path: Path) -> object:
        if isinstance(event, ScalarEvent):
            return self._scalar(event, path)
        if len(path) >= DEEPEST:
            raise self._error(TOO_DEEP, event, ())
        if isinstance(event, MappingStartEvent):
            self._expect(event, "map", path)
            return self._mapping(path)
        self._expect(event, "seq", path)
        items: list[object] = []
        assert isinstance(event, SequenceStartEvent)
        while not isinstance(item := self.next(), SequenceEndEvent):
            here = (*path, len(items))
            self._place(here, item)
            items.append(self.value(item, here))
        return items

    def _alias(self, event: AliasEvent, path: Path) -> object:
        name = event.anchor
        if name in self.open:
            raise self._error("this alias (*name) refers to a value that contains the alias", event, path)
        if name not in self.anchors:
            raise self._error(
                f"this is not valid YAML: found undefined alias '{name}' (a text that begins with * needs quotes)",
                event,
            )
        data, count, length, origin, below = self.anchors[name]
        self._add(count, length, event, path)
        if len(path) + _depth(data) > DEEPEST:
            raise self._error(TOO_DEEP, event, ())
        if self.has_lines:
            self.lines |= {(*path, *place[len(origin) :]): self.lines[place] for place in self.placed[below]}
        return _copied(data)

    def _place(self, path: Path, event: Event) -> None:
        if self.has_lines:
            self.lines[path] = event.start_mark.line + 1
            self.placed.append(path)

    def _add(self, count: int, length: int, event: Event, path: Path) -> None:
        self.count += count
        self.length += length
        if self.count > LARGEST:
            raise self._error(
                f"this is too large: more than {LARGEST} values after expansion of aliases", event, path[:1]
            )
        if self.length > LONGEST:
            raise self._error(
                f"this is too large: more than {LONGEST >> 20} MiB after expansion of aliases", event, path[:1]
            )

    def _mapping(self, path: Path) -> dict[str, object]:
        result: dict[str, object] = {}
        merged: dict[str, object] = {}
        first: dict[str, int] = {}
        while not isinstance(event := self.next(), MappingEndEvent):
            if isinstance(event, ScalarEvent) and _is_merge(event):
                merged = self._merge(self.next(), path) | merged
                continue
            key = self._key(event, path)
            line = event.start_mark.line + 1
            if key in result:
                raise self._error(f"the key '{key}' occurs twice (first on line {first[key]})", event, (*path, key))
            first[key] = line
            self._place((*path, key), event)
            if (
                re.match(r"\d+( |$)", key)
                and type(next(reversed(result.values()), None)) is int
                and self._after(event) in ",}"
            ):
                message = (
                    f"YAML ends a value at a comma and takes '{key}' for a key; write numbers with a decimal point"
                )
                raise self._error(message, event, path)
            result[key] = self.value(self.next(), (*path, key))
        return merged | result

    def _merge(self, event: Event, path: Path) -> dict[str, object]:
        sources = self.value(event, path)
        merged: dict[str, object] = {}
        for source in sources if isinstance(sources, list) else [sources]:
            if not isinstance(source, dict):
                raise self._error("`<<` takes a mapping, or a list of mappings", event, path)
            merged = source | merged
        return merged

    def _key(self, event: Event, path: Path) -> str:
        key = self.anchors.get(event.anchor, (None,))[0] if isinstance(event, AliasEvent) else None
        if isinstance(event, ScalarEvent):
            key = str(event.value)
            self._add(0, len(key), event, path)
            if event.anchor is not None:
                self.anchors[event.anchor] = (key, 1, len(key), path, slice(0))
        if not isinstance(key, str):
            raise self._error("a key should be text, not a list or mapping", event, path)
        return key

    def _scalar(self, event: ScalarEvent, path: Path) -> object:
        text = str(event.value)
        self._add(0, len(text), event, path)
        if not event.style and (event.tag is None or event.tag.removeprefix(CORE) in IMPLICIT):
            if text.count("(") > text.count(")") and self._after(event) == ",":
                message = f"YAML ends this value at its comma, after '{text}'; put an expression with commas in quotes"
                raise self._error(message, event, path)
            return self._resolved(text, event, path)
        self._expect(event, "str", path)
        return text

    def _after(self, event: Event) -> str:
        """Return the character after an event; empty at the end."""
        return self.text[event.end_mark.index : event.end_mark.index + 1]

    def _resolved(self, text: str, event: Event, path: Path) -> object:
        data = resolved(text)
        if isinstance(data, int) and abs(data) > LARGEST_NUMBER:
            raise self._error("this number is too large", event, path)
        return data

    def _expect(self, event: Any, kind: str, path: Path) -> None:
        if event.tag not in (None, "!", f"{CORE}{kind}"):
            tag = str(event.tag).replace(CORE, "!!")
            raise self._error(f"the tag {tag} is not allowed: a spec is plain data", event, path)

    def _error(self, message: str, event: Event, path: Path = ()) -> SpecError:
        return SpecError(message, key=path_text(path), line=event.start_mark.line + 1)


def _is_merge(event: ScalarEvent) -> bool:
    return bool(event.value == "<<" and not event.style and event.tag in (None, f"{CORE}merge"))


def _copied(data: object) -> object:
    match data:
        case dict():
            return {key: _copied(value) for key, value in data.items()}
        case list():
            return [_copied(value) for value in data]
    return data


def _depth(data: object) -> int:
    match data:
        case dict():
            return 1 + max(map(_depth, data.values()), default=0)
        case list():
            return 1 + max(map(_depth, data), default=0)
    return 0


def resolved(text: str) -> object:
    """Return the value of a scalar that has neither quotes nor a tag."""
    if text in CONSTANTS:
        return CONSTANTS[text]
    if text[0] not in "+-.0123456789":
        return text
    if len(text) > 400 and (WHOLE.fullmatch(text) or OTHER_BASE.fullmatch(text)):
        return LARGEST_NUMBER + 1  # converting it would take long, or fail
    if WHOLE.fullmatch(text):
        return int(text)
    if OTHER_BASE.fullmatch(text):
        return int(text, 0)
    if NUMBER.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if NOT_FINITE.fullmatch(text) else text


def _syntax(error: yaml.MarkedYAMLError, text: str) -> SpecError:
    mark = error.problem_mark or error.context_mark
    line = None if mark is None else mark.line + 1
    lines = text.splitlines()
    if line is not None and line <= len(lines) and re.match(r" *\t", lines[line - 1]):
        return SpecError("this line is indented with a tab; YAML allows only spaces", line=line)
    before, after = (text, "") if mark is None else (text[: mark.index], text[mark.index : mark.index + 1])
    if sum(map(before.count, "[{")) - sum(map(before.count, "]}")) > DEEPEST:
        # libyaml reads up to 1024 characters ahead, and has a limit of its own that it may meet before ours.
        return SpecError(TOO_DEEP, line=line)
    problem = " ".join(str(error.problem or error.context or "it cannot be read").split())
    begin = error.context_mark.line + 1 if error.context_mark is not None else line
    if begin != line:
        problem += f", in the block that begins on line {begin}"
    missing_colon = error.context == "while scanning a simple key"
    hint = " (is there a colon and a space after the key?)" if missing_colon else HINTS.get(after, "")
    return SpecError(f"this is not valid YAML: {problem}{hint}", line=line)


def write_yaml(data: object) -> str:
    """Write plain data as YAML; `read_yaml` of the result returns equal data.

    `data`: dicts, lists, text, numbers, booleans and None.
    """
    text: str = yaml.dump(data, Dumper=_Dumper, default_flow_style=None, sort_keys=False, width=120, allow_unicode=True)
    return text


class _Dumper(_DUMPER):  # type: ignore[misc]
    """Dumper without aliases that puts text in quotes if it would otherwise be refused, or read as another type."""

    def ignore_aliases(self, data: object) -> bool:
        """Write repeated values in full instead of as aliases."""
        return True


def _text(dumper: yaml.SafeDumper, data: str) -> yaml.ScalarNode:
    is_plain = isinstance(resolved(data), str) and data.count("(") <= data.count(")")
    style = None if is_plain else '"'
    return dumper.represent_scalar(f"{CORE}str", data, style=style)


_Dumper.add_representer(str, _text)
