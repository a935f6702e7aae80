"""Types of the arrays in a bundle, and example bundles made from them.

A bundle is a NamedTuple whose fields are arrays of these types, or other bundles. Compiled code reads a bundle from its
address, so the type of every array must be known at compile time. An example bundle of empty arrays provides the types.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, get_args, get_type_hints

import numpy as np

RealVector = Annotated[np.ndarray, np.float64, 1]
RealMatrix = Annotated[np.ndarray, np.float64, 2]
IntVector = Annotated[np.ndarray, np.int64, 1]
IntMatrix = Annotated[np.ndarray, np.int64, 2]
NumberVector = Annotated[np.ndarray, None, 1]
"""Vector of real or complex numbers; the dtype is the same for all such fields of a bundle."""


@cache
def _fields_of(bundle: Any) -> tuple[Any, ...]:
    """Return the annotations of the fields of a bundle, which take long to evaluate."""
    return tuple(get_type_hints(bundle, include_extras=True).values())


def example_of(bundle: Any, number: type = np.float64) -> Any:
    """Return a bundle of empty arrays with the declared types.

    Parameters
    ----------
    bundle
        A NamedTuple class whose fields are annotated with the types of this module, or with other such classes.
    number
        The dtype of `NumberVector` fields.
    """
    values = []
    for kind in _fields_of(bundle):
        if isinstance(kind, type):
            values.append(example_of(kind, number))
        else:
            _, dtype, dimensions = get_args(kind)
            values.append(np.zeros((0,) * dimensions, dtype or number))
    return bundle(*values)
