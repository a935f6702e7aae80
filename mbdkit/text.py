"""Formats messages: lists of names, "did you mean" hints, plain-text tables."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the known name closest to `word`, or an empty string."""
    names = {name.casefold(): name for name in known}
    close = difflib.get_close_matches(word.casefold(), names, n=1, cutoff=0.6)
    return f" (did you mean '{names[close[0]]}'?)" if close else ""


def listed(names: Iterable[str], last: str = "") -> str:
    """Join names as ``a, b and c`` if `last` is ``and``, or as ``a, b, c`` if it is empty."""
    words = list(names)
    if not last or len(words) < 2:
        return ", ".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def counted(number: int, one: str, many: str = "") -> str:
    """Return ``1 joint`` or ``2 joints``; `many` is the plural if it is not `one` plus s."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def one_line(error: BaseException) -> str:
    """Return the type and message of an exception on one line; messages are truncated to 300 characters.

    Control characters are escaped, see `printable`.
    """
    try:
        text = str(error)
    except Exception:  # of a plugin
        return f"{type(error).__name__}, whose message cannot be shown"
    text = printable(" ".join(text[:10_000].split()))
    text = text if len(text) <= 300 else text[:297] + "..."
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def printable(text: str) -> str:
    """Return text with control characters and lone surrogates escaped: HDF5, terminals and streams may refuse them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def table(rows: Sequence[Sequence[str]], indent: str = "") -> str:
    """Return rows of text in aligned columns."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        indent + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
