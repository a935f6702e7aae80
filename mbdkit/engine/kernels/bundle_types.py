"""Types of the arrays of a bundle, and declarations of those that repeated steps and checkpoints need.

A bundle is a NamedTuple whose fields are arrays of these types, or other bundles. Compiled code reads a bundle from its
address, so the type of every array must be known at compile time. An example bundle of empty arrays provides the types.

The fields of the bundles of runs and methods are of three kinds. Arrays of type `State` are read by the next step: they
are restored before a step is repeated, and checkpoints store them. Arrays of type `Record` accumulate over a run, or
are changed by failed steps; checkpoints store them as well. All other fields are constants, scratch and output, and are
never stored. `kept` collects the arrays by these declarations, so that there is no other list of them.

``Annotated[RealMatrix, 3]`` is the type of matrices with three columns: further arguments are the sizes of the last
axes. Compiled code then computes the addresses of elements with constants, which saves a tenth of the time.
"""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, TypeVar, get_args

import numpy as np

from mbdkit.engine.native.bundle import fields_of

RealVector = Annotated[np.ndarray, np.float64, 1]
RealMatrix = Annotated[np.ndarray, np.float64, 2]
IntVector = Annotated[np.ndarray, np.int64, 1]
IntMatrix = Annotated[np.ndarray, np.int64, 2]
RealCube = Annotated[np.ndarray, np.float64, 3]
RealTensor = Annotated[np.ndarray, np.float64, 4]
ComplexVector = Annotated[np.ndarray, np.complex128, 1]
ComplexMatrix = Annotated[np.ndarray, np.complex128, 2]
#: Vector of real or complex numbers; the dtype is the same for all such fields of a bundle.
NumberVector = Annotated[np.ndarray, None, 1]

Bundle = TypeVar("Bundle", bound=tuple[object, ...])

STATE, RECORD = "state", "record"
State = Annotated[np.ndarray, STATE]
Record = Annotated[np.ndarray, RECORD]


def example_of(bundle: type[Bundle], number: type = np.float64) -> Bundle:
    """Return a bundle of empty arrays with the declared types.

    Parameters
    ----------
    bundle
        A NamedTuple class whose fields are annotated with the types of this module, or with other such classes.
    number
        The dtype of `NumberVector` fields.
    """
    values = []
    for kind in fields_of(bundle):
        if hasattr(kind, "_fields"):  # a bundle, which may be declared as `State`
            values.append(example_of((get_args(kind) or (kind,))[0], number))
        else:
            _, dtype, dimensions, *sizes = get_args(kind)
            values.append(np.zeros((*(0,) * (dimensions - len(sizes)), *sizes), dtype or number))
    return bundle(*values)


def kept(bundle: Any, *roles: str) -> dict[str, np.ndarray]:
    """Return the arrays of a bundle that are declared with one of the roles STATE and RECORD, by name.

    If a field with one of these roles is itself a bundle, all its arrays are returned; if a field without a role is a
    bundle, the arrays that its own class declares. Names of nested fields are joined by dots.
    """
    arrays: dict[str, np.ndarray] = {}
    cls: type[tuple[Any, ...]] = type(bundle)
    for name, value, is_wanted in zip(bundle._fields, bundle, _wanted(cls, roles), strict=True):
        if isinstance(value, tuple):
            inner = _leaves(value) if is_wanted else kept(value, *roles)
            arrays |= {f"{name}.{inside}": array for inside, array in inner.items()}
        elif is_wanted:
            arrays[name] = value
    return arrays


@cache
def _wanted(bundle: type[tuple[Any, ...]], roles: tuple[str, ...]) -> tuple[bool, ...]:
    """Return whether each field of a bundle is declared with one of the roles."""
    declared = (getattr(kind, "__metadata__", ()) for kind in fields_of(bundle))
    return tuple(any(role in words for role in roles) for words in declared)


def _leaves(bundle: Any) -> dict[str, np.ndarray]:
    return dict(zip(bundle._fields, bundle, strict=True))
