"""The text of a run spec whose initial values are those after assembly, so that its start is consistent."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import yaml

from mbdkit.base.errors import SpecError
from mbdkit.base.plain_data import copied
from mbdkit.base.text import listed
from mbdkit.engine.assembly import AssembledState
from mbdkit.mechanism.bodies import Body
from mbdkit.runs.findings import findings
from mbdkit.runs.preparation import build
from mbdkit.spec import RunSpec, load_spec
from mbdkit.spec.reading import read_text
from mbdkit.spec.yaml_reader import write_yaml

SAME = 1e-9  #: Largest relative difference of two numbers of mechanisms that count as the same.

#: Keys of points that are given in the global frame at the initial positions, and the place of their body.
_ENDS = {"at": 0, "from": 0, "to": 1}

_Edit = tuple[int, int, str]  #: Start and end of a part of a text, and the text that replaces it.


def assembled_text(spec: RunSpec, start: AssembledState, text: str) -> tuple[str, bool]:
    """Return the text of a spec with the initial values after assembly, and whether it keeps the given text.

    Only the initial values of bodies, and points that are given in the global frame at the initial positions, are
    replaced in the text. If this does not define the same mechanism, for example because a body is an alias of another
    one or the model computes the bodies, the text contains the mechanism in full.

    `text`: the text of the spec in YAML or JSON; empty if there is none, or if it lacks values that were set otherwise.
    Raises SpecError if the start of the new spec would be doubtful again.
    """
    mechanism = spec.mechanism()
    moved = {
        name: body.model_copy(
            update={"position": (x, y), "angle": angle, "velocity": (vx, vy), "angular_velocity": rate}
        )
        for (name, body), (x, y, angle), (vx, vy, rate) in zip(
            mechanism.bodies.items(), start.q.tolist(), start.v.tolist(), strict=True
        )
    }
    model = mechanism.to_spec()
    for name, body in model["bodies"].items():
        body |= dict(_values(moved[name]))
    if text:
        with suppress(SpecError, yaml.YAMLError):
            edited = _edited(text, mechanism.bodies, moved)
            if _is_same(_loaded(spec, edited).mechanism().to_spec(), model):
                _check(_loaded(spec, edited))
                return edited, True
    document = spec._document
    data: dict[str, object] = {} if document is None else copied(document.data)
    written = write_yaml({**data, "model": model})
    _check(_loaded(spec, written))
    return written, False


def _loaded(spec: RunSpec, text: str) -> RunSpec:
    document = read_text(text, "the assembled spec", ".yaml")
    document.folder = spec.folder
    return load_spec(document)


def _check(spec: RunSpec) -> None:
    if doubts := findings("start", spec, build(spec)[1]):
        message = f"the start stays doubtful also from the assembled pose: {doubts[0]}"
        raise SpecError(f"{message}; `accept: [{doubts[0].criterion}]` accepts it")


def _values(body: Body) -> Iterator[tuple[str, object]]:
    for key in ("position", "angle", "velocity", "angular_velocity"):
        value = getattr(body, key)
        if any(value) if isinstance(value, tuple) else value:
            yield key, list(value) if isinstance(value, tuple) else value


def _edited(text: str, bodies: Mapping[str, Body], moved: Mapping[str, Body]) -> str:
    model = _entry(yaml.compose(text, Loader=yaml.SafeLoader), "model")
    edits: list[_Edit] = []
    for name, body in moved.items():
        node = _entry(_entry(model, "bodies"), name)
        if isinstance(node, yaml.MappingNode):
            edits += _edits_of_body(text, node, bodies[name], body)
    for section in _mappings(model):
        for element in _mappings(section):
            edits += _edits_of_points(text, element, bodies, moved)
    for begin, end, new in sorted(edits, reverse=True):
        text = text[:begin] + new + text[end:]
    return text


def _edits_of_body(text: str, node: yaml.MappingNode, body: Body, moved: Body) -> Iterator[_Edit]:
    added = []
    for key in ("position", "angle", "velocity", "angular_velocity"):
        before, after = getattr(body, key), getattr(moved, key)
        if before == after:
            continue
        if (value := _entry(node, key)) is not None:
            yield _replacement(text, value, after)
        else:
            added.append(f"{key}: {_text(after)}")
    if added:
        begin = node.start_mark.index
        if node.flow_style:
            yield begin + 1, begin + 1, ", ".join(added) + (", " if node.value else "")
        else:
            between = "\n" + " " * node.start_mark.column
            yield begin, begin, between.join([*added, ""])


def _edits_of_points(
    text: str, element: yaml.MappingNode, given: Mapping[str, Body], moved: Mapping[str, Body]
) -> Iterator[_Edit]:
    """Yield the replacements of the points of an element, which keep their places on the bodies."""
    bodies = _entry(element, "bodies") or _entry(element, "body")
    names = [name.value for name in (bodies.value if isinstance(bodies, yaml.SequenceNode) else [bodies]) if name]
    for key, index in _ENDS.items():
        node = _entry(element, key)
        on = [name for name in (names if key == "at" else names[index : index + 1]) if name in given]
        if not isinstance(node, yaml.SequenceNode) or not on or given[on[0]] == moved[on[0]]:
            continue
        with suppress(TypeError, ValueError):  # expressions
            x, y = (float(coordinate.value) for coordinate in node.value)
            old, new = given[on[0]], moved[on[0]]
            turn = new.angle - old.angle
            dx, dy = x - old.position[0], y - old.position[1]
            point = (
                new.position[0] + math.cos(turn) * dx - math.sin(turn) * dy,
                new.position[1] + math.sin(turn) * dx + math.cos(turn) * dy,
            )
            yield _replacement(text, node, point)


def _replacement(text: str, node: yaml.Node, value: float | Sequence[float]) -> _Edit:
    begin, end = node.start_mark.index, node.end_mark.index
    return begin, begin + len(text[begin:end].rstrip()), _text(value)


def _text(value: float | Sequence[float]) -> str:
    return repr(value + 0.0) if isinstance(value, float) else f"[{listed(map(_text, value))}]"


def _entry(node: yaml.Node | None, key: str) -> yaml.Node | None:
    """Return the value of a key that is written at this place, and not at that of an alias; None without one."""
    for name, value in node.value if isinstance(node, yaml.MappingNode) else ():
        is_here = name.start_mark.index <= value.start_mark.index <= node.end_mark.index  # type: ignore[union-attr]
        if name.value == key and is_here:
            return value
    return None


def _mappings(node: yaml.Node | None) -> Iterator[yaml.MappingNode]:
    for _, value in node.value if isinstance(node, yaml.MappingNode) else ():
        if isinstance(value, yaml.MappingNode):
            yield value


def _is_same(value: object, other: object) -> bool:
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        keys = {key for key in value.keys() | other.keys() if value.get(key) or other.get(key)}
        return all(_is_same(value.get(key, 0.0), other.get(key, 0.0)) for key in keys)
    if isinstance(value, list | tuple) and isinstance(other, list | tuple) and len(value) == len(other):
        return all(map(_is_same, value, other))
    if isinstance(value, int | float) and isinstance(other, int | float):
        return math.isclose(value, other, rel_tol=SAME, abs_tol=SAME)
    return bool(value == other)


def write_assembled(spec: RunSpec, start: AssembledState, text: str, path: Path) -> bool:
    """Write `assembled_text` to a new file, and return whether it keeps the given text.

    Raises SpecError if the file exists, if it is in another folder than files that the spec names, or if its start
    stays doubtful.
    """
    from mbdkit.base.files import check_suffix, replacing

    check_suffix(path, (".yaml", ".yml"), "a spec")
    if spec.files_read and path.resolve().parent != spec.folder.resolve():
        raise SpecError(f"the spec names files in its folder; write into {spec.folder}", file=path)
    written, is_kept = assembled_text(spec, start, text)
    with replacing(path, overwrite=False) as temporary:
        temporary.write_text(written, encoding="utf-8", newline="\n")
    return is_kept
