"""Declares the columns and labels of histories, for type checkers and completion.

``python -m tests.history_columns`` writes them from the table of quantities.
"""

from __future__ import annotations

from pathlib import Path

from mbdkit.archive import history
from mbdkit.archive.named_columns import VIEWS, columns_of, view_of
from mbdkit.archive.recorded_data import RecordedData
from mbdkit.base.parts import GROUPS_OF_PARTS
from mbdkit.quantities.array import Kind
from mbdkit.quantities.registered_kinds import added_kinds, kind_of_group

TARGET = Path(history.__file__).with_name("recorded_columns.pyi")

_HEADER = '''"""Columns and labels of histories by group, written by ``python -m tests.history_columns``."""

import numpy as np

from mbdkit.archive.named_columns import Histories, View
'''


def declarations() -> str:
    """Return the text of the stub."""
    own = [group for group, view in VIEWS.items() if view.__module__ == history.__name__]
    kinds = [kind_of_group(group) for group in [*own, *(group for group in added_kinds() if group in GROUPS_OF_PARTS)]]
    kinds = [kind for kind in kinds if kind.labels or [*columns_of(kind)]]  # others have no histories
    further = [kind for kind in kinds if kind.one and kind.word not in vars(RecordedData)]
    imports = sorted(f"from {view.__module__} import {view.__name__}\n" for view in map(view_of, further))
    properties = "".join(map(_property, further))
    return _HEADER + "".join([*imports, *map(_class, kinds)]) + "\nclass FurtherKinds:\n" + properties


def _property(kind: Kind) -> str:
    view = view_of(kind)
    what = str(view.__doc__).partition("\n")[0]
    return f'    @property\n    def {kind.word}(self) -> Histories[{view.__name__}]:\n        """{what}"""\n'


def _name(kind: Kind) -> str:
    return kind.group.title().replace("_", "")


def _class(kind: Kind) -> str:
    lines = [f'    {name}: np.ndarray\n    """{column.__doc__}"""\n' for name, column in columns_of(kind)]
    for name, arrays in kind.labels.items():
        lines.append(f"    {name}: {'str' if len(arrays) == 1 else 'tuple[str, str]'}\n")
    return f'\nclass {_name(kind)}(View, of="{kind.group}"):\n' + "".join(lines)


if __name__ == "__main__":
    TARGET.write_text(declarations(), encoding="utf-8", newline="\n")
