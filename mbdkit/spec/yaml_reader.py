"""Reading of YAML 1.2 as plain data with line numbers; rejects object tags, duplicate keys and alias bombs."""

from __future__ import annotations

import io
import re
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.representer import SafeRepresenter

from mbdkit.errors import SpecError
from mbdkit.plain_data import Path, path_text

LARGEST = 1_000_000  # values, after expansion of aliases

CORE = "tag:yaml.org,2002:"
IMPLICIT = ("null", "bool", "int", "float", "timestamp", "merge", "value")
NULL = re.compile(r"~|null|Null|NULL|")
TRUE = re.compile(r"true|True|TRUE")
FALSE = re.compile(r"false|False|FALSE")
WHOLE = re.compile(r"[-+]?[0-9]+")
OTHER_BASE = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")

HINTS = {
    "mapping values are not allowed": " (is the line indented too far, or does a text with a colon need quotes?)",
    "cannot start any token": " (put the text in quotes)",
    "undefined alias": " (a text that begins with * needs quotes)",
    "could not find expected ':'": " (is there a colon and a space after the key?)",
}


def read_yaml(text: str) -> tuple[Any, dict[Path, int]]:
    """Parse YAML; return the plain data and the line number of each key path, counted from 1.

    Parameters
    ----------
    text
        One YAML document; None is returned for an empty document.

    Raises
    ------
    SpecError
        If the text is not YAML, or not plain data, with the line number.
    """
    try:
        node = YAML(typ="safe", pure=True).compose(text)
        if node is None:
            return None, {}
        reader = _Reader()
        return reader.value(node, ()), reader.lines
    except MarkedYAMLError as error:
        raise _syntax(error, text) from None
    except (YAMLError, ValueError) as error:
        if isinstance(error, SpecError):
            raise
        raise SpecError(f"this is not valid YAML: {_first_line(error)}") from None
    except RecursionError:
        raise SpecError("this YAML is nested too deeply") from None


class _Reader:
    def __init__(self) -> None:
        self.lines: dict[Path, int] = {}
        self.count = 0
        self.open: set[int] = set()

    def value(self, node: Node, path: Path) -> Any:
        self.count += 1
        if self.count > LARGEST:
            raise self._error(
                f"this is too large: more than {LARGEST} values after expansion of aliases", node, path[:1]
            )
        if isinstance(node, ScalarNode):
            return self._scalar(node, path)
        if id(node) in self.open:
            raise self._error("this alias (*name) refers to a value that contains the alias", node, path)
        self.open.add(id(node))
        try:
            match node:
                case MappingNode():
                    self._expect(node, "map", path)
                    return self._mapping(node, path)
                case SequenceNode():
                    self._expect(node, "seq", path)
                    items = []
                    for index, item in enumerate(node.value):
                        self.lines.setdefault((*path, index), item.start_mark.line + 1)
                        items.append(self.value(item, (*path, index)))
                    return items
        finally:
            self.open.discard(id(node))
        raise self._error("this is not plain data", node, path)

    def _mapping(self, node: MappingNode, path: Path) -> dict[str, Any]:
        result: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if isinstance(key_node, ScalarNode) and key_node.tag == f"{CORE}merge":
                merged = self._merge(value_node, path) | merged
                continue
            key = self._key(key_node, path)
            line = key_node.start_mark.line + 1
            if key in result:
                first = self.lines[*path, key]
                raise self._error(f"the key '{key}' occurs twice (first on line {first})", key_node, (*path, key))
            self.lines[*path, key] = line
            result[key] = self.value(value_node, (*path, key))
        return merged | result

    def _merge(self, node: Node, path: Path) -> dict[str, Any]:
        sources = node.value if isinstance(node, SequenceNode) else [node]
        merged: dict[str, Any] = {}
        for source in sources:
            if not isinstance(source, MappingNode):
                raise self._error("`<<` takes a mapping, or a list of mappings", source, path)
            merged = self.value(source, path) | merged
        return merged

    def _key(self, node: Node, path: Path) -> str:
        if not isinstance(node, ScalarNode):
            raise self._error("a key should be text, not a list or mapping", node, path)
        return str(node.value)

    def _scalar(self, node: ScalarNode, path: Path) -> Any:
        text = str(node.value)
        if not node.style and str(node.tag).removeprefix(CORE) in IMPLICIT:
            return self._resolved(text, node, path)
        self._expect(node, "str", path)
        return text

    def _resolved(self, text: str, node: Node, path: Path) -> Any:
        if NULL.fullmatch(text):
            return None
        if TRUE.fullmatch(text) or FALSE.fullmatch(text):
            return bool(TRUE.fullmatch(text))
        if WHOLE.fullmatch(text):
            if len(text) > 300:
                raise self._error("this number is too large", node, path)
            return int(text)
        if OTHER_BASE.fullmatch(text):
            return int(text, 0)
        if NUMBER.fullmatch(text):
            return float(text)
        if NOT_FINITE.fullmatch(text):
            return float(text.replace(".", ""))
        return text

    def _expect(self, node: Node, kind: str, path: Path) -> None:
        if node.tag != f"{CORE}{kind}":
            tag = str(node.tag).replace(CORE, "!!")
            raise self._error(f"the tag {tag} is not allowed: a spec is plain data", node, path)

    def _error(self, message: str, node: Node, path: Path) -> SpecError:
        return SpecError(message, key=path_text(path), line=node.start_mark.line + 1)


def _syntax(error: MarkedYAMLError, text: str) -> SpecError:
    mark = error.problem_mark or error.context_mark
    line = None if mark is None else mark.line + 1
    problem = " ".join(str(error.problem or error.context or "it cannot be read").split())
    lines = text.splitlines()
    if line is not None and line <= len(lines) and re.match(r" *\t", lines[line - 1]):
        return SpecError("this line is indented with a tab; YAML allows only spaces", line=line)
    if "another document" in problem:
        return SpecError("a second YAML document begins here; a spec is a single document", line=line)
    begin = error.context_mark.line + 1 if error.context_mark is not None else line
    if begin != line:
        problem += f", in the block that begins on line {begin}"
    hint = next((hint for words, hint in HINTS.items() if words in problem), "")
    return SpecError(f"this is not valid YAML: {problem}{hint}", line=line)


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)


def write_yaml(data: Any) -> str:
    """Write plain data as YAML; `read_yaml` of the result returns equal data.

    Parameters
    ----------
    data
        Dicts, lists, text, numbers, booleans and None.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None  # mappings and lists of scalars on one line
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    yaml.Representer = _Representer
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()


class _Representer(SafeRepresenter):
    """Representer that puts text in quotes if it would otherwise be read as another type."""

    def represent_str(self, data: str) -> ScalarNode:
        stays = isinstance(_Reader()._resolved(data, ScalarNode("", data), ()), str) and data[:1] not in (":", "?")
        style = (
            None if stays else '"'
        )  # ruamel writes texts that begin with : or ? without quotes, but reads them as syntax
        return self.represent_scalar(f"{CORE}str", data, style=style)


_Representer.add_representer(str, _Representer.represent_str)
