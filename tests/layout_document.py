"""Writes the layout table to the format document: ``python -m tests.layout_document schemas/archive.md``."""

from __future__ import annotations

import sys
from pathlib import Path

from mbdkit.base.parts import GROUPS_OF_PARTS
from mbdkit.quantities.registered_kinds import kinds

BEGIN = "<!-- layout: begin (python -m tests.layout_document schemas/archive.md) -->"
END = "<!-- layout: end -->"


def table() -> str:
    """Return the layout as a Markdown table."""
    rows = ["| array | axes | type | units | what |", "|---|---|---|---|---|"]
    for array in (array for kind in kinds(GROUPS_OF_PARTS) for array in kind.arrays):
        units = f"mixed: {array.row_units}" if array.row_units else array.units
        what = f"{array.long_name} (optional)" if array.optional else array.long_name
        rows.append(f"| `{array.path}` | {', '.join(array.dims)} | `{array.dtype}` | {units} | {what} |")
    return "\n".join(rows)


def renewed(text: str) -> str:
    """Return the document with the table between the two markers replaced."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the document lacks {BEGIN} or {END}")
    return f"{before}{BEGIN}\n\n{table()}\n\n{END}{after}"


if __name__ == "__main__":
    document = Path(sys.argv[1])
    document.write_text(renewed(document.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
