"""Declares the columns of histories as class attributes, for type checkers and completion.

``python -m mbdkit_testing.history_columns mbdkit/archive/history.py`` writes the declarations from the table of
quantities. At run time, `View` creates the columns from the same table.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from mbdkit.archive.named_columns import columns_of
from mbdkit.quantities.table import BY_GROUP

MARK = "    # columns (python -m mbdkit_testing.history_columns mbdkit/archive/history.py)\n"

_CLASS = re.compile(
    r'^class \w+\(View, of="(?P<group>\w+)"\):\n    """(?:.|\n)*?"""\n'
    rf"(?P<columns>\n{re.escape(MARK)}(?:    \w+: np\.ndarray\n)*)?",
    re.MULTILINE,
)


def renewed(source: str) -> str:
    """Return the source of `mbdkit.archive.history` with the declarations of columns replaced."""

    def declared(found: re.Match[str]) -> str:
        begin = found[0].removesuffix(found["columns"] or "")
        lines = [f"    {name}: np.ndarray\n" for name, _ in columns_of(BY_GROUP[found["group"]])]
        return begin + "\n" + MARK + "".join(lines)

    return _CLASS.sub(declared, source)


if __name__ == "__main__":
    module = Path(sys.argv[1])
    module.write_text(renewed(module.read_text(encoding="utf-8")), encoding="utf-8")
