"""The section `defaults` of a model, whose components complete those of the same type."""

from __future__ import annotations

from xml.etree.ElementTree import Element

MOST = 1_000_000  #: Largest number of elements that defaults add; it bounds those that complete each other.


class TooManyError(Exception):
    """Defaults add more than `MOST` elements."""


def apply_defaults(model: Element) -> None:
    """Add the properties in the section `defaults` of a model to components of the same type that lack them.

    Like other components, defaults are completed by those before them.
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
                        raise TooManyError
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
