"""What packaged tableaus with closed forms have: the JSON file beside `mbdkit.methods.tableau`.

``python -m tests.integrators.stored_tableaus > mbdkit/methods/tableau.json`` writes it, from mpmath's numbers.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from mbdkit.methods import dop853, dopri5, gauss, radau_iia, rk4, rk_gill
from mbdkit.methods.tableau import ButcherTableau

TABLEAUS = [
    *(gauss.tableau(stages) for stages in (1, 2, 3)),
    *(radau_iia.tableau(stages) for stages in (2, 3)),
    *(module.tableau() for module in (rk4, rk_gill, dopri5, dop853)),
]
"""Tableaus with closed forms or rounded coefficients."""


def computed(tableau: ButcherTableau) -> dict[str, Any]:
    """Return the results of a tableau's methods, computed with 60 digits: truth values, or arrays as triples."""
    names = ["_check", "_rounded"] + [
        f"is_{name}"
        for name in ("explicit", "diagonally_implicit", "first_same_as_last", "collocation", "stiffly_accurate")
    ]
    if tableau.is_diagonalisable:
        names += ["second_order_floats", "eigensystem"]
    return {name: _plain(_unstored(name)(tableau)) for name in names}


def _unstored(name: str) -> Any:
    item = vars(ButcherTableau)[name]
    return getattr(item, "fget", getattr(item, "func", item)).__wrapped__


def _plain(value: Any) -> Any:
    if not isinstance(value, tuple):
        return value
    return [[x.dtype.name, x.shape, x.ravel().view(float).tolist()] for x in map(np.ascontiguousarray, value)]


def text() -> str:
    """Return the text of the file: one line for each result of a tableau."""
    blocks = (
        f'  "{tableau._key}": {{\n'
        + ",\n".join(f'    "{name}": {json.dumps(value)}' for name, value in computed(tableau).items())
        + "\n  }"
        for tableau in TABLEAUS
    )
    return "{\n" + ",\n".join(blocks) + "\n}\n"


if __name__ == "__main__":
    print(text(), end="")
