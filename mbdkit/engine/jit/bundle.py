"""Bundles of arrays at a fixed address: a call from Python passes one address instead of all arrays.

Unpacking the arrays of a mechanism takes 4 to 8 us per call, ten times the computing time of a kernel on a small
mechanism. A bundle is therefore unpacked once into a block of memory with the layout of the compiled NamedTuple, and
kernels read the arrays from this block.

In compiled code, a loaded bundle is a pointer to the block. It is passed as one word, and only those arrays that the
code names are read.

This module uses the public API of Numba (``numba.extending``) and llvmlite: `intrinsic`, `infer_getattr`,
`lower_getattr_generic`, `register_model`, `models`, and the IR builder. It also uses internals of Numba:
`AttributeTemplate`, `types.BaseNamedTuple`, and the memory layout of an array, `_ARRAY_FIELDS`, which is checked before
anything is compiled. Unlike for subkernels, no path without these internals exists.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, typeof, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

JIT_DISABLED: bool = bool(vars(config)["DISABLE_JIT"])
"""Whether Numba is switched off (``NUMBA_DISABLE_JIT=1``), so that kernels run as Python functions."""
_PYTHON_BUNDLES: dict[int, Any] = {}
"""Bundles by the address of their block; used only with NUMBA_DISABLE_JIT=1."""

_Address, _HEAD = ctypes.c_ssize_t, object.__basicsize__

_ARRAY_FIELDS = ("meminfo", "parent", "nitems", "itemsize", "data", "shape", "strides")
"""Members of an array in compiled code, in the order in which `_words` writes them."""


class _Pointer(types.Type):
    """Numba type of a pointer to the compiled form of a bundle."""

    def __init__(self, bundle: Any):
        self.bundle = bundle
        # The name is short because it becomes part of the mangled name of every function with such an argument.
        digest = hashlib.sha256(str(bundle).encode()).hexdigest()[:8]
        super().__init__(name=f"{bundle.instance_class.__name__}_{digest}")


@register_model(_Pointer)
class _PointerModel(models.OpaqueModel):
    """Represents a `_Pointer` in memory as an address."""


@infer_getattr
class _Attributes(AttributeTemplate):
    key = _Pointer

    def generic_resolve(self, value: Any, name: str) -> Any:  # type: ignore[override]
        """Return the type of an attribute: an array, or a pointer to a bundle inside the bundle."""
        if name not in value.bundle.fields:
            return None
        kind = value.bundle.types[value.bundle.fields.index(name)]
        return _Pointer(kind) if isinstance(kind, types.BaseNamedTuple) else kind


@lower_getattr_generic(_Pointer)
def _read(context, builder, kind, value, name):
    """Generate code that reads one array of a bundle, or returns a pointer to a bundle inside it.

    The metadata ``invariant.load`` allows LLVM to read each array descriptor only once per function. This is valid
    because a block does not change while a kernel runs.
    """
    index = kind.bundle.fields.index(name)
    word = ir.IntType(32)
    whole = builder.bitcast(value, context.get_value_type(kind.bundle).as_pointer())
    place = builder.gep(whole, [ir.Constant(word, 0), ir.Constant(word, index)], inbounds=True)
    if isinstance(kind.bundle.types[index], types.BaseNamedTuple):
        return builder.bitcast(place, value.type)
    found = builder.load(place)
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found


def bundle_loader(example: Callable[[], tuple[Any, ...]]) -> Any:
    """Return a function for compiled code that turns an address into the bundle stored there.

    Parameters
    ----------
    example
        Returns a bundle of the same type; called only during compilation.
    """
    if JIT_DISABLED:
        return _PYTHON_BUNDLES.__getitem__

    @intrinsic
    def load(typing_context, address):
        kind = _Pointer(typeof(example()))

        def generate(context, builder, signature, arguments):
            _check_array_layout(context)
            return builder.inttoptr(arguments[0], context.get_value_type(kind))

        return kind(types.intp), generate

    return load


def _check_array_layout(context: Any) -> None:
    """Raise NotImplementedError if this version of Numba has another memory layout of arrays than `_words` writes."""
    fields = tuple(context.data_model_manager.lookup(types.Array(types.float64, 1, "C"))._fields)
    if fields != _ARRAY_FIELDS:
        raise NotImplementedError(
            f"this version of Numba stores arrays as {fields}, not as {_ARRAY_FIELDS}: install a version within the "
            "tested range (`mbdkit plugins doctor`)"
        )


def _words(bundle: Any) -> list[int]:
    """Return the compiled form of a bundle: the members `_ARRAY_FIELDS` of each array.

    The first two, `meminfo` and `parent`, are zero: Python owns the memory of all arrays, and kernels count no
    references.
    """
    words: list[int] = []
    for x in bundle:
        if isinstance(x, tuple):
            words += _words(x)
        else:
            words += (0, 0, x.size, x.itemsize, _data_address(x), *x.shape, *x.strides)
    return words


def _data_address(array: np.ndarray) -> int:
    """Return the address of the data of an array.

    It is the first member of NumPy's array object after the head of every Python object, which is part of the public
    binary interface of NumPy (``PyArrayObject_fields``). Reading it there takes a tenth of the 0.8 us of
    ``array.ctypes.data``; a run of a small mechanism needs about 500 addresses.
    """
    return int(_Address.from_address(id(array) + _HEAD).value)


class PinnedBundle:
    """A bundle that kernels can read at `address` during the lifetime of this object.

    The object keeps a reference to the bundle, and so to its arrays.

    Parameters
    ----------
    bundle
        A NamedTuple of arrays, and of NamedTuples of arrays.
    """

    def __init__(self, bundle: Any):
        self._block = np.zeros(0, dtype=np.int64)
        self.replace(bundle)

    def replace(self, bundle: Any) -> None:
        """Store another bundle of the same type; `address` may change."""
        self.bundle = bundle
        words = _words(bundle)
        if len(words) != len(self._block):
            self._block = np.zeros(len(words), dtype=np.int64)
        self._block[:] = words
        self.address: int = self._block.ctypes.data
        if JIT_DISABLED:
            _PYTHON_BUNDLES[self.address] = bundle
