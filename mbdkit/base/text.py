"""Formats messages: lists of names, "did you mean" hints, numbers with error bars, plain-text tables."""

from __future__ import annotations

import difflib
import json
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

MOST_DIGITS = 10  #: Largest number of significant digits of a number with an error.

#: Numbers are printed without an exponent if the power of ten of their first digit is in this range.
SMALLEST_PLACE, LARGEST_PLACE = -3, 8

_HARMFUL = re.compile(
    "[\0-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff"  # not allowed in XML, or interpreted by terminals
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ufeff]"  # reverse or hide text
)

#: Names of this package for what other programs and textbooks call by another name.
SYNONYMS: dict[str, list[str]] = json.loads(Path(__file__).with_name("synonyms.json").read_text(encoding="utf-8"))


def did_you_mean(word: str, known: Iterable[str], most: int = 1) -> str:
    """Return ``" (did you mean 'x'?)"`` for the known names that are meant by `word` elsewhere, or else for at most
    `most` that are closest to it; an empty string if there are none.
    """
    if len(word) > 300:
        return ""
    names = {name.casefold(): name for name in known}
    close = [name for name in SYNONYMS.get(word.casefold(), []) if name in names]
    close = close or difflib.get_close_matches(word.casefold(), names, n=most, cutoff=0.6)
    return f" (did you mean {listed([repr(names[key]) for key in close], 'or')}?)" if close else ""


def listed(names: Iterable[str], last: str = "", most: int | None = None) -> str:
    """Join names as ``a, b and c`` if `last` is ``and`` (or another word), or as ``a, b, c`` if `last` is empty; with
    `most`, only this many of them, and how many others there are.
    """
    words = list(names)
    if most is not None and len(words) > most:
        words[most:] = [f"{len(words) - most} more"]
    if not last or len(words) < 2:
        return ", ".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def told_apart(first: float, second: float, digits: int = 6) -> tuple[str, str]:
    """Return two numbers as text, with at least `digits` digits, and with as many as show two digits of their
    difference.
    """
    size, apart = max(abs(first), abs(second)), abs(first - second)
    if apart > 0.0 and math.isfinite(size) and math.isfinite(apart):
        digits = min(17, max(digits, 2 + math.ceil(math.log10(size / apart))))
    return f"{first:.{digits}g}", f"{second:.{digits}g}"


class Bar(NamedTuple):
    """How far the true value may lie below and above a number, in its unit; nan if unknown."""

    lower: float = math.nan
    upper: float = math.nan

    @classmethod
    def even(cls, error: float) -> Bar:
        """Return the bar with two equal ends."""
        return cls(error, error)

    @property
    def is_known(self) -> bool:
        """Whether both ends are known."""
        return math.isfinite(self.lower + self.upper)


def plus_minus(value: float, error: float | tuple[float, float], sign: str = "+-", digits: int = MOST_DIGITS) -> str:
    """Return a value and its error as text, such as ``368.2 +- 0.3``.

    The value is rounded to the place of the error's first digit. If the error is 10 or more and the value is printed
    without an exponent, it is rounded to the place of the error's second digit, as in ``3600 +- 210``. A value that is
    smaller than its error keeps as many digits of its own, as in ``430 +- 1800``, so that it is not rounded to zero.
    If the value has too few digits for its error, the error is half a unit of its last digit, which is what rounding
    may change. A value without an error is exact. A value that is not finite has no known error.

    `value`, `error`: the value and its error, in the same unit; an error that is nan is unknown. An error with two
    different ends is written as ``1970 (-380, +900)``; the smaller one determines the digits. `sign`: sign between the
    value and the error. `digits`: largest number of significant digits of the value.
    """
    if isinstance(error, tuple):
        lower, upper = error
        if Bar(*error).is_known and lower != upper:
            number = plus_minus(value, min(error), sign, digits).partition(" ")[0]
            return f"{number} (-{_error_text(lower)}, +{_error_text(upper)})"
        error = max(error) if Bar(*error).is_known else math.nan
    if not (math.isfinite(value) and math.isfinite(error)):
        return f"{value:.4g} (error unknown)"
    if error <= 0:
        return f"{value:.{digits}g}"
    of_error = math.floor(math.log10(error))
    own = math.floor(math.log10(abs(value))) if value else of_error
    first = max(own, of_error)
    error = max(error, 0.5 * 10.0 ** (first - digits + 1)) if of_error < first - digits + 1 else error
    if has_exponent(first):
        return f"{value:.{min(first - of_error, digits - 1)}e} {sign} {error:.2g}"
    last = max(min(own, of_error), first - digits + 1)
    last -= of_error > 0 or last > 0
    return f"{round(value, -last):.{max(0, -last)}f} {sign} {_error_text(error)}"


def _error_text(error: float) -> str:
    place = math.floor(math.log10(error)) if 0 < error < math.inf else 0
    return f"{round(error, 1 - place):.0f}" if 0 < place <= LARGEST_PLACE else f"{error:.2g}"


def has_exponent(place: int) -> bool:
    """Return whether numbers whose first digit has this power of ten are printed with an exponent."""
    return not SMALLEST_PLACE <= place <= LARGEST_PLACE


def counted(number: int, one: str, many: str = "") -> str:
    """Return ``1 joint`` or ``2 joints``; `many` is the plural if it is not `one` plus s."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def one_line(error: BaseException) -> str:
    """Return the type and message of an exception on one line; messages are truncated to 300 characters.

    Control characters are escaped, see `shown`.
    """
    if (text := _text_of(error)) is None:
        return f"{type(error).__name__}, whose message cannot be shown"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def message_of(error: BaseException) -> str:
    """Return the message of an exception on one line, escaped and truncated as by `one_line`, but without the type."""
    text = _text_of(error)
    return one_line(error) if text is None else text


def _text_of(error: BaseException) -> str | None:
    """Return the message of an exception, or None if it has none: that of a plugin may raise any exception itself."""
    try:
        return shortened(shown(" ".join(str(error)[:10_000].split())))
    except KeyboardInterrupt:
        raise
    except BaseException:
        return None


def shortened(text: str) -> str:
    """Return text shortened to 300 characters; dots replace the end of a longer text."""
    return text if len(text) <= 300 else text[:297] + "..."


def bounded(text: str) -> str:
    """Return a sentence without words of more than 1000, and lines of more than 5000 characters, which files and
    arguments contain by mistake.
    """
    lines = re.sub(r"\S{1001,}", lambda word: word[0][:997] + "...", text).split("\n")
    return "\n".join(line if len(line) <= 5000 else line[:4997] + "..." for line in lines)


def shown(text: object, *, lines: bool = False) -> str:
    r"""Return text from files with control characters, such as those of a terminal, escaped as ``\u001b``.

    `lines`: whether line feeds and tabulators remain unescaped.
    """
    return _HARMFUL.sub(lambda match: match[0] if lines and match[0] in "\n\t" else _escaped(match), str(text))


def _escaped(match: re.Match[str]) -> str:
    """Return a character as it is escaped in JSON; all characters of `_HARMFUL` are below U+10000."""
    return {"\n": "\\n", "\t": "\\t", "\r": "\\r"}.get(match[0], f"\\u{ord(match[0]):04x}")


#: Characters with which formulas in spreadsheets begin; some spreadsheets also accept their full-width forms.
_FORMULAS = ("=", "+", "-", "@", "\uff1d", "\uff0b", "\uff0d", "\uff20")


def csv_cell(text: str) -> str:
    """Return text from files as a cell of a table.

    An apostrophe precedes the text if a spreadsheet would evaluate it as a formula.
    """
    text = shown(text)
    return f"'{text}" if text[:1] in _FORMULAS else text


def grouped_table(rows: Iterable[tuple[str, str, str]]) -> str:
    """Return rows of a group, a name and a text in aligned columns, below the groups, in the order of first rows."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for group, name, text in rows:
        groups.setdefault(group, []).append((name, text))
    lines = table([row for members in groups.values() for row in members], "  ").splitlines()
    blocks = [f"{group}\n" + "\n".join(lines.pop(0) for _ in members) for group, members in groups.items()]
    return "\n\n".join(blocks)


def table(rows: Sequence[Sequence[str]], indent: str = "") -> str:
    """Return rows of text in aligned columns; control characters in cells are escaped."""
    rows = [[shown(cell) for cell in row] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        indent + "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
