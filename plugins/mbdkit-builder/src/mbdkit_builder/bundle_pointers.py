"""Bundles of arrays (`mbdkit.engine.native.bundle`) in compiled code, where they are pointers to blocks of memory."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

from llvmlite import ir
from numba import typeof, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_getattr_generic, models, register_model

from mbdkit.engine.native.bundle import ARRAY_FIELDS, LOADERS, axes_of
from mbdkit_builder.implementation import implement


class Pointer(types.Type):
    """Numba type of a pointer to the compiled form of a bundle."""

    def __init__(self, bundle: Any):
        self.bundle = bundle
        # The name is short because it becomes part of the mangled name of every function with such an argument.
        digest = hashlib.sha256(str(bundle).encode()).hexdigest()[:8]
        super().__init__(name=f"{bundle.instance_class.__name__}_{digest}")


@register_model(Pointer)
class _PointerModel(models.OpaqueModel):
    """Represents a `Pointer` in memory as an address."""


@infer_getattr
class _Attributes(AttributeTemplate):
    key = Pointer

    def generic_resolve(self, value: Any, name: str) -> Any:  # type: ignore[override]
        """Return the type of an attribute: an array, or a pointer to a bundle inside the bundle."""
        if name not in value.bundle.fields:
            return None
        kind = value.bundle.types[value.bundle.fields.index(name)]
        return Pointer(kind) if isinstance(kind, types.BaseNamedTuple) else kind


@lower_getattr_generic(Pointer)
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
    return _with_sizes(builder, found, kind.bundle.types[index], axes_of(kind.bundle.instance_class)[index])


def _with_sizes(builder: Any, array: Any, kind: Any, axes: Mapping[int, int]) -> Any:
    """Return an array whose declared sizes, and the strides that follow from them, are constants for LLVM."""
    word = ir.IntType(64)
    shape, strides = ARRAY_FIELDS.index("shape"), ARRAY_FIELDS.index("strides")
    for axis, size in axes.items():
        array = builder.insert_value(array, word(size), [shape, axis])
    if isinstance(kind, types.Array) and axes:  # nothing reads the strides of arrays of items
        stride = kind.dtype.bitwidth // 8
        for axis in range(kind.ndim - 1, min(axes) - 2, -1):
            array = builder.insert_value(array, word(stride), [strides, axis])
            stride *= axes.get(axis, 0)
    return array


def define_loaders() -> None:
    """Define the functions made by `bundle_loader` for compiled code."""
    for load, example in LOADERS:
        implement(load)(_pointer_to(example))


def _pointer_to(example: Callable[[], tuple[Any, ...]]) -> Callable[..., Any]:
    def load(typing_context, address):
        kind = Pointer(typeof(example()))

        def generate(context, builder, signature, arguments):
            _check_array_layout(context)
            return builder.inttoptr(arguments[0], context.get_value_type(kind))

        return kind(types.intp), generate

    return load


def _check_array_layout(context: Any) -> None:
    """Raise RuntimeError if this version of Numba has another memory layout of arrays than `array_words`."""
    fields = tuple(context.data_model_manager.lookup(types.Array(types.float64, 1, "C"))._fields)
    if fields != ARRAY_FIELDS:
        raise RuntimeError(f"this version of Numba stores arrays as {fields}, not as {ARRAY_FIELDS}")
