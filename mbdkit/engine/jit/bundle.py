"""Bundles of arrays that stay with the kernels, so that a call from Python hands over one address instead of them all.

Unpacking the arrays of a mechanism costs 4 to 8 us a call, ten times what the kernel does with a small mechanism. So a
bundle is unpacked once, its compiled form is kept in a block of memory, and kernels read it back from there.

In compiled code a bundle that was read back is a pointer to the block: it is handed on as one word, and of its arrays
only those are read that somebody names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, typeof, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

_COMPILED = not vars(config)["DISABLE_JIT"]
_PLAIN: dict[int, Any] = {}
"""Bundles by the address of their block, where nothing is compiled."""


class _Pointer(types.Type):
    """Points at the compiled form of a bundle."""

    def __init__(self, bundle: Any):
        self.bundle = bundle
        # a name that is short, because it becomes part of the names of all functions that take it
        digest = hashlib.sha256(str(bundle).encode()).hexdigest()[:8]
        super().__init__(name=f"{bundle.instance_class.__name__}_{digest}")


@register_model(_Pointer)
class _PointerModel(models.OpaqueModel):
    """A bare address."""


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
    """Read one array of a bundle, which does not change while a kernel runs, or point at a bundle inside it."""
    index = kind.bundle.fields.index(name)
    word = ir.IntType(32)
    whole = builder.bitcast(value, context.get_value_type(kind.bundle).as_pointer())
    place = builder.gep(whole, [ir.Constant(word, 0), ir.Constant(word, index)], inbounds=True)
    if isinstance(kind.bundle.types[index], types.BaseNamedTuple):
        return builder.bitcast(place, value.type)
    found = builder.load(place)
    found.set_metadata("invariant.load", builder.module.add_metadata([]))
    return found


def loader(example: Callable[[], tuple[Any, ...]]) -> Any:
    """Return what reads a bundle back in compiled code, given its address.

    Parameters
    ----------
    example
        Makes a bundle of the same type; called only while something is compiled.
    """
    if not _COMPILED:
        return _PLAIN.__getitem__

    @intrinsic
    def load(typing_context, address):
        kind = _Pointer(typeof(example()))

        def generate(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(kind))

        return kind(types.intp), generate

    return load


def _words(bundle: Any) -> list[int]:
    """Return a bundle's compiled form: of each array owner, parent, numbers of items and bytes, place, shape, strides.

    The first two are for arrays that compiled code owns, and stay empty.
    """
    words: list[int] = []
    for x in bundle:
        if isinstance(x, tuple):
            words += _words(x)
        else:
            words += (0, 0, x.size, x.itemsize, x.__array_interface__["data"][0], *x.shape, *x.strides)
    return words


class Hold:
    """A bundle kept for the kernels; they find it under `address` for as long as this object lives.

    Parameters
    ----------
    bundle
        A NamedTuple of arrays, and of NamedTuples of arrays.
    """

    def __init__(self, bundle: Any):
        self._block = np.zeros(0, dtype=np.int64)
        self.replace(bundle)

    def replace(self, bundle: Any) -> None:
        """Keep another bundle of the same type; `address` may change."""
        self.bundle = bundle
        words = _words(bundle)
        if len(words) != len(self._block):
            self._block = np.zeros(len(words), dtype=np.int64)
        self._block[:] = words
        self.address: int = self._block.ctypes.data
        if not _COMPILED:
            _PLAIN[self.address] = bundle
