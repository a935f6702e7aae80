"""The parts of mbdkit, and what specs and archives may contain although the part that adds it is not installed.

``parts.json`` has the name of each part, and, as lists, the keys of its elements in the model, its sections of run
specs, the markers of its kinds of specs, and its groups in archives.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

_PARTS = json.loads(Path(__file__).with_suffix(".json").read_text(encoding="utf-8"))


def _parts_by(kind: str) -> Mapping[str, str]:
    return {word: f"mbdkit-{part}" for part, words in _PARTS.items() for word in words.get(kind, ())}


#: Names of the parts; `mbdkit_NAME` is the package, and `mbdkit-NAME` the word in messages.
PARTS = tuple(sorted(_PARTS))

#: The packages of mbdkit itself: the core and its parts.
OWN_PACKAGES = ("mbdkit", *(f"mbdkit_{part}" for part in PARTS))

ELEMENTS_OF_PARTS = _parts_by("elements")  #: Parts by the keys of their elements in the model.

SECTIONS_OF_PARTS = _parts_by("sections")  #: Parts by their sections of run specs.

#: Parts by the markers of their specs, which are not run specs where the part is not installed either.
MARKERS_OF_PARTS = _parts_by("markers")

GROUPS_OF_PARTS = _parts_by("groups")  #: Parts by their groups in archives.
