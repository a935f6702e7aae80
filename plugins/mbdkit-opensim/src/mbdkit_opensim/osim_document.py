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

#: First format versions of OpenSim 3, of the format that describes joints by frames, as written by OpenSim 4, and of
#: the format with `appliesForce`, `isEnforced` and `enabled` in place of `isDisabled`.
OLDEST, WITH_FRAMES, WITH_SWITCHES = 30_000, 30_500, 30_508

LARGEST = 50 * 2**20  #: Largest size of a file [bytes]; models of the full body have less than 5 MB.

#: Largest number of elements that the section `defaults` adds; it bounds those that complete each other.
MOST = 1_000_000

KEY = "model.file"


#: Largest numbers of characters of a message, which may contain texts of a file, and of a name in it.
LONGEST, LONGEST_NAME = 1000, 200


def refused(message: str) -> SpecError:
    """Return the exception for a file that cannot be read or is not planar."""
    return SpecError(message if len(message) <= LONGEST else f"{message[: LONGEST - 3]}...", key=KEY)


def read_model(file: str) -> Element:
    """Return the element `Model` of a file.

    Raises
    ------
    SpecError
        If the file cannot be read, or is not a model in the format of OpenSim 3 or 4.
    """
    path = Path(file)
    try:
        path = path.expanduser().absolute()
    except RuntimeError as error:  # for ~ or ~USER without a home
        raise refused(f"{file}: {error}") from None
    root, size = _read_document(path)
    _read_parts(root, path, LARGEST - size, (path,))
    model = root.find("Model")
    if model is None:
        raise refused(f"{path} contains no <Model>")
    version = int(root.get("Version", ""))
    if version < WITH_SWITCHES:
        rename_switches(model)
    _apply_defaults(model, path)
    if version < WITH_FRAMES:
        as_format_4(model)
    return model


def _apply_defaults(model: Element, path: Path) -> None:
    """Add the properties in the section `defaults` of a model to components of the same type that lack them.

    Like other components, defaults are completed by those before them. Raise SpecError if they add too many elements.
    """
    properties: dict[str, dict[str, list[Element]]] = {}  # by type and tag
    sizes: dict[int, int] = {}
    left = MOST

    def complete(element: Element) -> None:
        nonlocal left
        for part in list(element.iter()):
            known = properties.get(part.tag, {})
            present = {child.tag for child in part} if known else set()
            for tag, added in known.items():
                if tag not in present:
                    left -= sum(sizes[id(child)] for child in added)
                    if left < 0:
                        raise refused(f"{path} has more than {MOST} components that its section `defaults` completes")
                    part.extend(added)

    for default in model.iterfind("defaults/*"):
        complete(default)
        known, new = properties.setdefault(default.tag, {}), dict[str, list[Element]]()
        for part in default:
            if part.tag not in known:
                new.setdefault(part.tag, []).append(part)
                sizes[id(part)] = sum(1 for _ in part.iter())
                left -= sizes[id(part)]
        known |= new
    for section in model:
        if section.tag != "defaults":
            complete(section)


def _read_document(path: Path) -> tuple[Element, int]:
    try:
        content = read_data(path, LARGEST)
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
    if not version.isdecimal() or int(version[:20]) < OLDEST:
        raise refused(f"{path} has a format before that of OpenSim 3; open it in OpenSim 4 and save it again")
    return root, len(content)


def _read_parts(root: Element, path: Path, largest: int, readers: tuple[Path, ...]) -> int:
    """Replace components with the attribute `file` by those in the files that it names, in the folder of the model.

    Parameters
    ----------
    root, path
        Root of a document, and its file.
    largest
        Largest size of all these files together [bytes].
    readers
        The file, and those that refer to it.

    Returns
    -------
    int
        What remains of `largest`.
    """
    for parent in root.iter():
        for index, element in enumerate(parent):
            if (name := element.get("file")) is None:
                continue
            of_part, label = path.parent / name, f"{label_of(element)} of {path}"
            if not of_part.resolve().is_relative_to(readers[-1].parent.resolve()):
                raise refused(f"{label} is in the file '{name}', which is not in the folder of the model")
            if of_part.resolve() in [reader.resolve() for reader in readers]:
                raise refused(f"{label} is in the file '{name}', which refers to itself")
            document, size = _read_document(of_part)
            if size > largest:
                raise refused(f"the files of {readers[-1]} are larger than {LARGEST / 2**20:g} MiB together")
            part = document.find(element.tag)
            if part is None:
                raise refused(f"{label} is in the file '{name}', which contains no <{element.tag}>")
            if document.get("Version") != root.get("Version"):
                raise refused(
                    f"{label} is in the file '{name}' of another format than that of the model; save both again"
                )
            largest = _read_parts(document, of_part, largest - size, (of_part, *readers))
            part = document.find(element.tag)
            assert part is not None
            part.set("name", part.get("name") or name_of(element))
            parent[index] = part
    return largest


def name_of(element: Element) -> str:
    """Return the name of a component or, without a name, its class."""
    return element.get("name") or element.tag


def label_of(element: Element) -> str:
    """Return class and name of a component, for error messages."""
    return f"{element.tag[:LONGEST_NAME]} '{name_of(element)[:LONGEST_NAME]}'"


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
