"""Bundles of arrays at a fixed address: a call from Python passes one address instead of all arrays.

A bundle is a NamedTuple whose fields are arrays, or other bundles. Unpacking the arrays of a mechanism takes 4 to 8 us
per call, ten times the computing time of a kernel on a small mechanism. A bundle is therefore unpacked once into a
block of memory, and kernels read the arrays from this block.

In compiled code, a loaded bundle is a pointer to the block. It is passed as one word, and only those arrays that the
code names are read. The types of its arrays follow from an example.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, get_args, get_type_hints

import numpy as np

from mbdkit.engine.native.machine_code import IN_PYTHON

#: Members of an array in compiled code, in the order in which `array_words` writes them.
ARRAY_FIELDS = ("meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides")
ARRAY_WORDS = 5  #: Number of words of an array without dimensions.

Bundle = tuple[Any, ...]  #: A NamedTuple of arrays, and of NamedTuples of arrays.

_Address, HEAD = ctypes.c_ssize_t, object.__basicsize__
#: Bundles by the address of their block; used only with ``MBDKIT_KERNELS=python``.
_PYTHON_BUNDLES: dict[int, Any] = {}

#: The functions made by `bundle_loader`, and their examples.
LOADERS: list[tuple[Callable[[int], Any], Callable[[], Bundle]]] = []


@cache
def fields_of(bundle: type) -> tuple[Any, ...]:
    """Return the annotations of the fields of a bundle, which take long to evaluate."""
    return tuple(get_type_hints(bundle, include_extras=True).values())


@cache
def axes_of(bundle: type) -> tuple[dict[int, int], ...]:
    """Return the sizes that the class of a bundle declares for each of its fields, by axis.

    ``Annotated[RealMatrix, 3]`` declares that the second axis has size 3; see `mbdkit.engine.kernels.bundle_types`.
    """
    found: list[dict[int, int]] = []
    for kind in fields_of(bundle):
        dimensions, *sizes = get_args(kind)[2:] or [0]
        found.append({dimensions - len(sizes) + i: size for i, size in enumerate(sizes)})
    return tuple(found)


def bundle_loader(example: Callable[[], Bundle]) -> Any:
    """Return a function for compiled code that turns an address into the bundle stored there.

    Parameters
    ----------
    example
        Returns a bundle of the same type; called only during compilation.
    """

    def load(address):
        return _PYTHON_BUNDLES[address]

    LOADERS.append((load, example))
    return load


class ArrayType(NamedTuple):
    """Type of the elements of an array, number of dimensions, and declared sizes as (axis, size)."""

    dtype: np.dtype[Any]
    dimensions: int
    sizes: tuple[tuple[int, int], ...]


@cache
def arrays_in(bundle: type) -> tuple[ArrayType, ...]:
    """Return the types of the arrays of a bundle of a class, nested bundles included."""
    found: list[ArrayType] = []
    for kind, sizes in zip(fields_of(bundle), axes_of(bundle), strict=True):
        if hasattr(kind, "_fields"):
            found += arrays_in(kind)
        else:
            _, dtype, dimensions = get_args(kind)[:3]
            found.append(ArrayType(np.dtype(dtype), dimensions, tuple(sizes.items())))
    return tuple(found)


def arrays_of(bundle: Bundle) -> list[Any]:
    """Return the arrays of a bundle in the order of `arrays_in`."""
    arrays: list[Any] = []
    for x in bundle:
        if isinstance(x, tuple):
            arrays += arrays_of(x)
        else:
            arrays.append(x)
    return arrays


def array_words(x: np.ndarray) -> tuple[int, ...]:
    """Return the members `ARRAY_FIELDS` of an array.

    The first two, `meminfo` and `parent`, are zero: Python owns the memory of all arrays, and kernels count no
    references.
    """
    return (0, 0, x.size, x.itemsize, _data_address(x), *x.shape, *x.strides)


def words_of(bundle: Bundle) -> list[int]:
    """Return a bundle as words: the members of each of its arrays.

    Raises
    ------
    TypeError
        If an axis of an array does not have its declared size.
    """
    words: list[int] = []
    for x in bundle:
        words += words_of(x) if isinstance(x, tuple) else array_words(x)
    kind = type(bundle)
    for field, axis, size in _declared(kind):
        if (shape := bundle[field].shape)[axis] != size:
            raise TypeError(f"an array of {kind.__name__} has shape {shape}; axis {axis} must have {size}")
    return words


@cache
def _declared(bundle: type) -> tuple[tuple[int, int, int], ...]:
    """Return the declared sizes of a class of bundles as (field, axis, size), without those of nested bundles."""
    axes = enumerate(axes_of(bundle))
    return tuple((field, axis, size) for field, sizes in axes for axis, size in sizes.items())


def _data_address(array: np.ndarray) -> int:
    """Return the address of the data of an array.

    In NumPy's array object, the address follows the header that every Python object has; this layout
    (``PyArrayObject_fields``) is part of NumPy's public binary interface. Reading the address there takes a tenth of
    the 0.8 us of ``array.ctypes.data``; a run of a small mechanism needs about 500 addresses.
    """
    return int(_Address.from_address(id(array) + HEAD).value)


class PinnedBundle:
    """A bundle that kernels can read at `address` during the lifetime of this object.

    The object keeps a reference to the bundle, and so to its arrays.

    Parameters
    ----------
    bundle
        A NamedTuple of arrays, and of NamedTuples of arrays.
    """

    def __init__(self, bundle: Bundle):
        self._block = np.zeros(0, dtype=np.int64)
        self.replace(bundle)

    def replace(self, bundle: Bundle) -> None:
        """Store another bundle of the same type; `address` may change."""
        self.bundle: Any = bundle
        words = words_of(bundle)
        if len(words) != len(self._block):
            self._block = np.zeros(len(words), dtype=np.int64)
        self._block[:] = words
        self.address: int = self._block.ctypes.data
        if IN_PYTHON:
            _PYTHON_BUNDLES[self.address] = bundle
