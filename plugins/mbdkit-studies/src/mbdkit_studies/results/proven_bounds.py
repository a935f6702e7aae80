"""Proofs that the largest value of a measure over a box of tolerances is at one of its corners."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence

from mbdkit.base.plain_data import Path
from mbdkit.mechanism.parameters import names_in
from mbdkit.runs.preparation import RunSetup
from mbdkit.spec.reading import parse_key
from mbdkit.spec.run_spec import RunSpec

#: Convex functions of reactions of joints.
_CONVEX = re.compile(r"(max|mean|rms|final)\(\s*(abs\(\s*)?joints\.(\w+|'[^']*')\.(force|torque)(\.[xy])?\s*\)?\s*\)")
_SECTIONS = {"name", "gravity", "bodies", "joints", "forces", "markers", "coordinates", "assembly"}
_TYPES = {
    "joints": {"revolute", "prismatic", "fixed", "point-on-line", "driver"},
    "forces": {"force", "torque", "spring-damper", "torsion-spring"},
}


def is_bounded_by_corners(spec: RunSpec, keys: Sequence[str], expression: str) -> bool:
    """Return whether the largest value of a measure over a box of numbers is proved to be at a corner of the box.

    In a mechanism all of whose coordinates are driven, the motion does not depend on masses and moments of inertia. If
    no force depends on reactions, and no joint is redundant, the reactions are linear functions of these numbers. A
    convex function of the reactions, such as their largest norm, is then largest at a corner.
    """
    data = json.loads(spec.canonical_json())
    model, paths = data["model"], [parse_key(key) for key in keys]
    names = {str(path[1]) for path in paths if path[0] == "parameters"}
    if (
        not _CONVEX.fullmatch(expression.strip())
        or model["name"] != "mechanism"
        or data.get("events")
        or any(value for section, value in model.items() if section not in _SECTIONS)
        or any(
            one["type"] not in kinds or one.get("friction") or "joints" in names_in(one)
            for section, kinds in _TYPES.items()
            for one in model.get(section, {}).values()
        )
        or not all(_is_inertial(path) for path in paths if path[0] != "parameters")
        or names & names_in(data.get("parameters", {}))
        or any(names & names_in(text) and not _is_linear(path, text, names) for path, text in _texts(model, ("model",)))
    ):
        return False
    mechanism = RunSetup.of(spec).workspace.mechanism
    return mechanism.freedoms().startswith("0 ") and not mechanism.redundancy.rows


def _is_inertial(path: Path) -> bool:
    return len(path) == 4 and path[1] == "bodies" and path[3] in ("mass", "inertia")


def _is_linear(path: Path, text: str, names: set[str]) -> bool:
    """Return whether a mass or an inertia is one of the names, or its product: ``m``, ``m*length**2/12``."""
    first, _, rest = re.sub(r"\s", "", text).partition("*")
    return _is_inertial(path) and first in names and not rest.startswith("*") and not names & names_in(rest)


def _texts(holder: object, path: Path) -> Iterator[tuple[Path, str]]:
    """Yield the texts in plain data with their paths."""
    if isinstance(holder, dict | list):
        for key, value in holder.items() if isinstance(holder, dict) else enumerate(holder):
            yield from _texts(value, (*path, key))
    elif isinstance(holder, str):
        yield path, holder
