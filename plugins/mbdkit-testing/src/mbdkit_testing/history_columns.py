"""Declares the columns and labels of histories, for type checkers and completion.

``python -m mbdkit_testing.history_columns`` writes them from the table of quantities.
"""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive import history
from mbdkit.archive.named_columns import VIEWS, columns_of
from mbdkit.quantities.array import Kind
from mbdkit.quantities.registered_kinds import OF_PARTS, added_kinds, item_of_group, kind_of_group
from mbdkit.registry.feature_items import QuantityKind

TARGET = Path(history.__file__).with_name("recorded_columns.pyi")

_HEADER = '''"""Columns and labels of histories by group, written by ``python -m mbdkit_testing.history_columns``."""

import numpy as np

from mbdkit.archive.named_columns import Histories, View
'''


def declarations() -> str:
    """Return the text of the stub."""
    groups = [group for group, view in VIEWS.items() if view.__module__ == history.__name__]
    own = [kind_of_group(group) for group in [*groups, *(group for group in added_kinds() if group in OF_PARTS)]]
    classes = "".join(map(_class, own))
    items = [item_of_group(kind.group) for kind in own[len(groups) :]]
    imports = "".join(f"from {one.history.module} import {one.history.name}\n" for one in items if one.history)
    return _HEADER + imports + classes + "\nclass KindsOfPlugins:\n" + "".join(map(_property, items))


def _property(item: QuantityKind) -> str:
    name = item.history.name if item.history else _name(kind_of_group(item.group))
    return f'    @property\n    def {item.word}(self) -> Histories[{name}]:\n        """{item.summary}"""\n'


def _name(kind: Kind) -> str:
    return kind.group.title().replace("_", "")


def _class(kind: Kind) -> str:
    lines = [f'    {name}: np.ndarray\n    """{column.__doc__}"""\n' for name, column in columns_of(kind)]
    for name, arrays in kind.labels.items():
        lines.append(f"    {name}: {'str' if len(arrays) == 1 else 'tuple[str, str]'}\n")
    return f'\nclass {_name(kind)}(View, of="{kind.group}"):\n' + "".join(lines)


if __name__ == "__main__":
    TARGET.write_text(declarations(), encoding="utf-8", newline="\n")
