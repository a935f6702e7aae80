"""Declares the columns and labels of histories, for type checkers and completion.

``python -m mbdkit_testing.history_columns`` writes them from the table of quantities.
"""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive import history
from mbdkit.archive.named_columns import VIEWS, columns_of
from mbdkit.quantities.array import Kind
from mbdkit.quantities.table import BY_GROUP

TARGET = Path(history.__file__).with_name("recorded_columns.pyi")

_HEADER = '''"""Columns and labels of histories by group, written by ``python -m mbdkit_testing.history_columns``."""

import numpy as np

from mbdkit.archive.named_columns import View
'''


def declarations() -> str:
    """Return the text of the stub."""
    groups = [group for group, view in VIEWS.items() if view.__module__ == history.__name__]
    return _HEADER + "".join(_class(BY_GROUP[group]) for group in groups)


def _class(kind: Kind) -> str:
    lines = [f'    {name}: np.ndarray\n    """{column.__doc__}"""\n' for name, column in columns_of(kind)]
    for name, arrays in kind.labels.items():
        lines.append(f"    {name}: {'str' if len(arrays) == 1 else 'tuple[str, str]'}\n")
    return f'\nclass {kind.group.title().replace("_", "")}(View, of="{kind.group}"):\n' + "".join(lines)


if __name__ == "__main__":
    TARGET.write_text(declarations(), encoding="utf-8", newline="\n")
