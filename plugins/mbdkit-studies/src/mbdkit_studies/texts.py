"""Messages of many runs: how they are compared, and how they are written on one line."""

from __future__ import annotations

import re

_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")

ERROR = "_error"  #: Suffix of the column with the estimated error of a measure in tables of studies.


def without_numbers(text: str) -> str:
    """Return a text with every number replaced by 0, so that messages that differ only in numbers are equal."""
    return _NUMBER.sub("0", text)


def joined_lines(text: str) -> str:
    """Return the lines of a message on one line."""
    return "; ".join(line.strip() for line in text.splitlines())
