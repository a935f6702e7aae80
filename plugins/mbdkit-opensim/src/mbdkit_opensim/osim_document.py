"""Reads `.osim` files. They are untrusted XML, and are read without entities and external references, as elements with
typed access.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from mbdkit import ResourceError, SpecError
from mbdkit.plugin import read_data
from mbdkit_opensim.osim_format_3 import as_format_4, rename_switches

OLDEST, WITH_FRAMES, WITH_SWITCHES = 30_000, 30_500, 30_508
"""First format versions of OpenSim 3, of the format that describes joints by frames, as written by OpenSim 4, and of
the format with `appliesForce`, `isEnforced` and `enabled` in place of `isDisabled`.
"""

LARGEST = 50 * 2**20
"""Largest size of a file [bytes]; models of the full body have less than 5 MB."""

KEY = "model.file"


def refused(message: str) -> SpecError:
    """Return the exception for a file that cannot be read or is not planar."""
    return SpecError(message, key=KEY)


def read_model(file: str) -> Element:
    """Return the element `Model` of a file.

    Raises
    ------
    SpecError
        If the file cannot be read, or is not a model in the format of OpenSim 3 or 4.
    """
    path = Path(file)
    try:
        path = path.expanduser()
    except RuntimeError as error:  # for ~ or ~USER without a home
        raise refused(f"{file}: {error}") from None
    try:
        content = read_data(path.absolute(), LARGEST)
    except (SpecError, ResourceError) as error:
        raise refused(str(error)) from None
    try:
        # Names such as HuntCrossleyForce::ContactParameters are not valid in XML with namespaces.
        root: Element = fromstring(re.sub(rb"(</?\w+)::(?=\w)", rb"\1__", content), forbid_dtd=True)
    except DefusedXmlException:
        raise refused(f"{path} contains a document type definition or entities, which are not read") from None
    except LookupError as error:
        raise refused(f"{path} declares an encoding that does not exist: {error}") from None
    except (ParseError, ValueError) as error:
        raise refused(f"{path} is not XML: {error}") from None
    if root.tag != "OpenSimDocument":
        raise refused(f"{path} is not a file of OpenSim: its root is <{root.tag}>, not <OpenSimDocument>")
    version = root.get("Version", "")
    if not version.isdecimal() or int(version) < OLDEST:
        raise refused(f"{path} has a format before that of OpenSim 3; open it in OpenSim 4 and save it again")
    model = root.find("Model")
    if model is None:
        raise refused(f"{path} contains no <Model>")
    if int(version) < WITH_SWITCHES:
        rename_switches(model)
    apply_defaults(model)
    if int(version) < WITH_FRAMES:
        as_format_4(model)
    return model


def apply_defaults(model: Element) -> None:
    """Add the properties in the section `defaults` of a model to components of the same type that lack them."""
    for default in model.iterfind("defaults/*"):
        for element in model.iterfind(f".//{default.tag}"):
            element.extend([part for part in default if element.find(part.tag) is None])


def name_of(element: Element) -> str:
    """Return the name of a component or, without a name, its class."""
    return element.get("name") or element.tag


def label_of(element: Element) -> str:
    """Return class and name of a component, for error messages."""
    return f"{element.tag} '{name_of(element)}'"


def text_of(element: Element, tag: str, default: str = "") -> str:
    """Return the text of a property."""
    return (element.findtext(tag) or default).strip()


def numbers_of(element: Element, tag: str, count: int | None, default: str = "") -> np.ndarray:
    """Return the numbers in a property. SpecError is raised unless there are `count` finite numbers."""
    words = text_of(element, tag, default).split()
    try:
        if not all(word.isascii() and "_" not in word for word in words):  # 1_0 is 1 in OpenSim, 10 in Python
            raise ValueError
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)) or (count is not None and len(values) != count):
        wanted = "finite numbers" if count is None else "a finite number" if count == 1 else f"{count} finite numbers"
        raise refused(f"{label_of(element)}: <{tag}> should be {wanted}, not '{' '.join(words)[:60]}'")
    return np.array(values)


def number_of(element: Element, tag: str, default: str = "") -> float:
    """Return a number of a property."""
    return float(numbers_of(element, tag, 1, default)[0])


def flag_of(element: Element, tag: str, *, default: bool = False) -> bool:
    """Return the truth value of a property."""
    text = text_of(element, tag, str(default)).lower()
    if text not in ("true", "false", "1", "0"):
        raise refused(f"{label_of(element)}: <{tag}> should be true or false, not '{text[:60]}'")
    return text in ("true", "1")


def objects_of(model: Element, group: str) -> Iterator[Element]:
    """Yield the members of a set of a model, such as `BodySet`."""
    yield from model.iterfind(f"{group}/objects/*")


def last_part(path: str) -> str:
    """Return the name of a component from its path, such as ``thigh`` of ``/bodyset/thigh``."""
    return path.rstrip("/").rsplit("/", 1)[-1]
