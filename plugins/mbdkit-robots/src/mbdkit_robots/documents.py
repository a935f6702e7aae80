"""Reads untrusted files: XML without entities, and numbers in attributes."""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from xml.etree.ElementTree import Element, ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from mbdkit import ResourceError, SpecError
from mbdkit.plugin import listed, read_data
from mbdkit_robots.planar import refused

LARGEST = 10 * 2**20  #: Largest size of a file [bytes].


def read_content(file: str) -> bytes:
    """Return the contents of a file; raise SpecError if it cannot be read or is too large."""
    try:
        return read_data(os.path.expanduser(file), LARGEST)
    except (SpecError, ResourceError) as error:
        raise refused(str(error)) from None


def read_xml(file: str, root: str) -> Element:
    """Return the root element of a file; raise SpecError if the file is not XML or its root has another name."""
    content = read_content(file)
    try:
        element: Element = fromstring(content, forbid_dtd=True)
    except DefusedXmlException:
        raise refused(f"{file} contains a document type definition or entities, which are not read") from None
    except (ParseError, ValueError) as error:
        raise refused(f"{file} is not XML: {error}") from None
    if element.tag != root:
        raise refused(f"{file} has the root <{element.tag}>, not <{root}>")
    return element


def numbers(element: Element | None, name: str, default: str, count: int | None = None) -> np.ndarray:
    """Return the numbers in an attribute; raise SpecError if they are not finite or their count is wrong."""
    text = default if element is None else element.get(name, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([math.nan])
    if not np.all(np.isfinite(values)) or (count is not None and len(values) != count):
        tag = "" if element is None else element.tag
        wanted = "finite numbers" if count is None else f"{count} finite number{'s' * (count > 1)}"
        raise refused(f'{name}="{text[:60]}" of <{tag}> should have {wanted}')
    return values


def number(element: Element | None, name: str, default: float) -> float:
    """Return the number in an attribute."""
    return float(numbers(element, name, repr(default), 1)[0])


def keyword(element: Element, name: str, default: str, allowed: Collection[str]) -> str:
    """Return the word in an attribute; raise SpecError if it is not one of those that are allowed."""
    word = element.get(name, default)
    if word not in allowed:
        raise refused(f'{name}="{word[:60]}" of <{element.tag}> should be {listed(allowed, "or")}')
    return word


def about(axis: int, angle: float) -> np.ndarray:
    """Return the matrix (3, 3) of a rotation about the x, y or z axis."""
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    values = np.eye(3)
    values[i, i], values[i, j], values[j, i], values[j, j] = c, -s, s, c
    return values


def unit(vector: np.ndarray, what: str) -> np.ndarray:
    """Return a vector scaled to length 1; raise SpecError if its length is zero."""
    size = float(np.linalg.norm(vector))
    if not size > 0:
        raise refused(f"{what} has no direction")
    return vector / size
