"""Texts of files, as sentences about these files cite them."""

from __future__ import annotations

from mbdkit.base.text import shortened, shown


def cited(text: object) -> str:
    """Return text from files for a sentence about it: escaped, see `shown`, and shortened to 300 characters."""
    return shortened(shown(str(text)[:301]))
