"""What the reader of MJCF files understands, and what cannot change a motion: the names in ``mjcf_schema.yaml``."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import yaml

from mbdkit_robots.documents import numbers
from mbdkit_robots.planar import SpatialModel

_NAMES = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text("utf-8"))


def _words(section: str) -> tuple[str, ...]:
    return tuple(_NAMES[section].split())


ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
UNDERSTOOD: dict[str, str] = _NAMES["understood"]
WITHOUT_EFFECT: dict[str, str] = _NAMES["without effect"]
LISTS, ZERO = _words("lists"), _words("zero")
OFF: dict[str, str] = _NAMES["values without effect"]
MODEL_SECTIONS, IDLE_SECTIONS, NOTED_SECTIONS = map(_words, ("model sections", "idle sections", "noted sections"))
LACKING_SECTIONS: dict[str, str] = _NAMES["lacking sections"]
BODY_PARTS = _words("body parts")
ACTUATORS, WITHOUT_FORCE, INHERITED = map(_words, ("actuators", "without force", "inherited"))


def leave_out_attributes(model: SpatialModel, element: Element, label: str, kind: str = "") -> None:
    """Note the attributes of an element that may change the motion but are not understood; `kind` is the key of the
    lists if it is not the tag.
    """
    kind = kind or element.tag
    known = f"{UNDERSTOOD.get(kind, '')} {WITHOUT_EFFECT.get(kind, '')}".split()
    for name, text in element.attrib.items():
        if name in known or text == OFF.get(name) or (name in ZERO and not np.any(numbers(element, name, "0"))):
            continue
        model.leave_out(f"{name} of <{element.tag}>", label, acts=True)
