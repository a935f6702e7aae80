"""From a function to machine code: Numba lowers it to LLVM, and LLVM optimizes it and emits an object file.

Numba optimizes for the processor of this machine. Here its unoptimized code is taken instead, so that the same code is
emitted for several processors. A wrapper with the C signature of `mbdkit.engine.native.kernel` is the only visible
symbol of an object file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, get_args

import llvmlite.binding as llvm
from llvmlite import ir
from numba import from_dtype, typeof, types
from numba.core import cgutils
from numpy import dtype

from mbdkit.engine.kernels.bundle_types import example_of
from mbdkit.engine.kernels.elementary import FUNCTIONS
from mbdkit.engine.native.bundle import ARRAY_WORDS
from mbdkit.engine.native.kernel import DTYPES, Kernel
from mbdkit.engine.native.levels import Level, Platform
from mbdkit_builder.bundle_pointers import Pointer
from mbdkit_builder.dual_arrays import DualArray
from mbdkit_builder.dual_types import DUAL
from mbdkit_builder.elementary_names import PREFIX, with_own_names
from mbdkit_builder.implementation import dispatcher
from mbdkit_builder.libraries import group_of
from mbdkit_builder.sources import ELEMENTARY

_WORD, _REAL, _BIT = ir.IntType(64), ir.DoubleType(), ir.IntType(1)
_POINTER = _REAL.as_pointer()
_SCALARS = {int: types.int64, bool: types.boolean, float: types.float64}
_TRIPLES = {"linux": "{}-unknown-linux-gnu", "macos": "{}-apple-macosx11.0.0", "windows": "{}-pc-windows-gnu"}

#: The description of an exception in LLVM's language, which is left out of machine code: nothing reads it, and it holds
#: the path of a source file, so that the code would depend on the folder in which it was built.
_EXCEPTION = re.compile(r"^(@\.const\.picklebuf\.\S+ = .*?constant (\{[^}]*\})) \{.*$", re.MULTILINE)

#: The address of a Python function that is an argument of a compiled one. Nothing reads it either, because Numba
#: compiles a version of the function for each such argument.
_OBJECT = re.compile(r"^(@numba\.dynamic\.globals\.\S+ = .*?global ptr) inttoptr \(.*$", re.MULTILINE)

#: Generates the body of a wrapper from context, builder, callee, signature and the wrapper's arguments.
Wrap = Callable[[Any, Any, Any, Any, list[Any]], None]


def kernel_module(kernel: Kernel) -> Any:
    """Return the unoptimized LLVM module of a kernel."""
    kinds, _ = kernel.signature
    arguments = tuple(map(_numba_type, kinds))

    def wrap(context: Any, builder: Any, callee: Any, signature: Any, given: list[Any]) -> None:
        place, values, are_right = sum(map(_words, arguments)), [], _BIT(1)
        types_at, place = place, place + len(DTYPES)
        at = 0
        for kind in arguments:
            address = builder.gep(given[0], [_WORD(at)])
            if isinstance(kind, types.Array):
                dtype_at = types_at + [from_dtype(one) for one in DTYPES].index(kind.dtype)
                dtype_ = builder.load(builder.gep(given[0], [_WORD(dtype_at)]))
                value, is_right = _array(context, builder, kind, builder.load(address), dtype_)
                are_right = builder.and_(are_right, is_right)
            else:
                value = _read(context, builder, kind, address)
            values.append(value)
            at += _words(kind)
        with builder.if_then(builder.not_(are_right), likely=False):
            builder.ret(_WORD(1))
        status, result = context.call_conv.call_function(builder, callee, signature.return_type, arguments, values)
        parts, returned = [result], [signature.return_type]
        if len(kernel.results) > 1:
            parts, returned = cgutils.unpack_tuple(builder, result, len(kernel.results)), list(signature.return_type)
        if not kernel.results:
            parts, returned = [], []
        for i, (wanted, kind, part) in enumerate(zip(kernel.results, returned, parts, strict=True)):
            value = context.cast(builder, part, kind, _SCALARS[wanted])
            value = (
                builder.bitcast(value, _WORD)
                if wanted is float
                else builder.zext(value, _WORD)
                if wanted is bool
                else value
            )
            builder.store(value, builder.gep(given[0], [_WORD(place + i)]), align=8)
        builder.ret(builder.select(status.is_error, _WORD(1), _WORD(0)))

    kind = ir.FunctionType(_WORD, [_WORD.as_pointer()])
    return linked_module(kernel.symbol, kernel.function, arguments, kind, wrap)


def entry_module(symbol: str, function: Callable[..., Any]) -> Any:
    """Return the unoptimized LLVM module of an entry, a function that kernels call by its address."""
    arguments = (types.int64, types.int64, types.float64, types.float64, types.float64)

    def wrap(context: Any, builder: Any, callee: Any, signature: Any, given: list[Any]) -> None:
        _, result = context.call_conv.call_function(builder, callee, signature.return_type, arguments, given)
        builder.ret(context.cast(builder, result, signature.return_type, types.int64))

    return linked_module(symbol, function, arguments, ir.FunctionType(_WORD, [_WORD, _WORD, _REAL, _REAL, _REAL]), wrap)


def law_module(symbol: str, function: Callable[..., Any], *, duals: bool) -> Any:
    """Return the unoptimized LLVM module of a function of force laws; see `mbdkit.engine.native.calls`."""
    number = DUAL if duals else types.float64
    arguments = (types.int64, number, number, types.float64, types.int64, types.int64)

    def wrap(context: Any, builder: Any, callee: Any, signature: Any, given: list[Any]) -> None:
        program, length, rate, time, parameters, out = given
        if duals:
            length, rate = (DualArray.load(builder, x) for x in (length, rate))
        places = [builder.ptrtoint(x, _WORD) for x in (parameters, out)]
        values = [program, length, rate, time, *places]
        context.call_conv.call_function(builder, callee, signature.return_type, arguments, values)
        builder.ret_void()

    state = _POINTER if duals else _REAL
    kind = ir.FunctionType(ir.VoidType(), [_WORD, state, state, _REAL, _POINTER, _POINTER])
    return linked_module(symbol, function, arguments, kind, wrap)


def _numba_type(kind: Any) -> Any:
    if kind in _SCALARS:
        return _SCALARS[kind]
    if hasattr(kind, "_fields"):
        return Pointer(typeof(example_of(kind)))
    _, number, dimensions = get_args(kind)[:3]
    return types.Array(from_dtype(dtype(number)), dimensions, "C")


def _words(kind: Any) -> int:
    if isinstance(kind, Pointer):
        return sum(_words_of_part(one) for one in kind.bundle)
    return 1


def _words_of_part(kind: Any) -> int:
    return ARRAY_WORDS + 2 * kind.ndim if isinstance(kind, types.Array) else _words(Pointer(kind))


def _array(context: Any, builder: Any, kind: Any, members: Any, dtype_: Any) -> tuple[Any, Any]:
    """Generate code for an array, and for whether it has the expected type.

    The array is read from the members of NumPy's array object (``PyArrayObject_fields`` of its public binary
    interface): data, number of dimensions, sizes, strides, base, type and flags, of which the first is that the array
    is C-contiguous.
    """
    half = ir.IntType(32)

    def member(offset: int, of: Any) -> Any:
        address = builder.inttoptr(builder.add(members, _WORD(offset)), of.as_pointer())
        return builder.load(address)

    flags, dimensions = member(48, half), member(8, half)
    is_right = builder.and_(
        builder.icmp_unsigned("==", member(40, _WORD), dtype_),
        builder.and_(
            builder.icmp_unsigned("==", dimensions, half(kind.ndim)),
            builder.icmp_unsigned("!=", builder.and_(flags, half(1)), half(0)),
        ),
    )
    sizes_at = member(16, _WORD)
    # If the array has another number of dimensions, nothing may be read behind its sizes.
    sizes_at = builder.select(
        is_right,
        sizes_at,
        builder.ptrtoint(
            cgutils.alloca_once_value(builder, ir.Constant(ir.ArrayType(_WORD, kind.ndim), [_WORD(0)] * kind.ndim)),
            _WORD,
        ),
    )
    sizes = [
        builder.load(builder.inttoptr(builder.add(sizes_at, _WORD(8 * i)), _WORD.as_pointer()))
        for i in range(kind.ndim)
    ]
    array = context.make_array(kind)(context, builder)
    array.data = builder.inttoptr(member(0, _WORD), array.data.type)
    array.shape = cgutils.pack_array(builder, sizes)
    itemsize = _WORD(kind.dtype.bitwidth // 8)
    strides = [itemsize]
    for size in reversed(sizes[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    array.strides = cgutils.pack_array(builder, strides)
    array.itemsize = itemsize
    count = sizes[0]
    for size in sizes[1:]:
        count = builder.mul(count, size)
    array.nitems = count
    return array._getvalue(), is_right


def _read(context: Any, builder: Any, kind: Any, address: Any) -> Any:
    if isinstance(kind, Pointer):
        return builder.bitcast(address, context.get_value_type(kind))
    if kind == types.float64:
        return builder.load(builder.bitcast(address, _POINTER))
    word = builder.load(address)
    return builder.trunc(word, _BIT) if kind == types.boolean else word


def linked_module(
    symbol: str, function: Any, arguments: Sequence[Any], kind: ir.FunctionType, wrap: Wrap, *, is_inlined: bool = False
) -> Any:
    """Return the unoptimized LLVM module of a C function, `kind`, and of all that it calls.

    Its body is generated by `wrap`, which calls the compiled function; `is_inlined` makes LLVM copy that into the body.
    """
    compiled, arguments = dispatcher(function, is_inlined), tuple(arguments)
    compiled.compile(arguments)
    found = compiled.overloads[arguments]
    context = found.target_context
    module = context.codegen().create_library(symbol).create_ir_module(symbol)
    wrapper = ir.Function(module, kind, symbol)
    builder = ir.IRBuilder(wrapper.append_basic_block("entry"))
    callee = context.declare_function(module, found.fndesc)
    wrap(context, builder, callee, found.signature, list(wrapper.args))
    linked = llvm.parse_assembly(str(module))
    code = with_own_names(str(found._asdict()["library"]._final_module))
    linked.link_in(llvm.parse_assembly(_OBJECT.sub(r"\1 null", _EXCEPTION.sub(r"\1 zeroinitializer", code))))
    linked.verify()
    return linked


def elementary_module() -> Any:
    """Return the unoptimized LLVM module of all elementary functions, as C functions of doubles.

    Every library has it once; kernels call these functions.
    """
    module = llvm.parse_assembly("")
    for name, function in FUNCTIONS.items():
        module.link_in(_definition(name, function))
    return module


def _definition(name: str, function: Callable[..., Any]) -> Any:
    count = function.__code__.co_argcount
    arguments = (types.float64,) * count

    def wrap(context: Any, builder: Any, callee: Any, signature: Any, given: list[Any]) -> None:
        _, result = context.call_conv.call_function(builder, callee, signature.return_type, arguments, given)
        builder.ret(result)

    kind = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()] * count)
    module = linked_module(f"{PREFIX}{name}", function, arguments, kind, wrap, is_inlined=True)
    for one in module.functions:
        if not one.is_declaration and not one.name.startswith(PREFIX):
            one.linkage = "linkonce_odr"  # several functions may share it
    return module


def optimized(module: Any, symbol: str, level: Level) -> Any:
    """Return a copy of the module of a symbol, optimized for a level.

    It is the same for all platforms with this level, as if they were Linux: what is tested there is tested for all.
    """
    machine = _machine(symbol, _TRIPLES["linux"].format(level.architecture), level)
    if group_of(symbol) == "gradients":
        # Every number has twelve derivatives. If each function were copied into its callers, the code would be ten
        # times larger.
        copy = llvm.parse_assembly(str(module).replace("alwaysinline", "nounwind"))
    else:
        copy = llvm.parse_bitcode(module.as_bitcode())
    copy.triple, copy.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = True
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(copy, builder)
    # Only after the optimization, which would copy every internal function that is called once into its caller.
    for value in (*copy.functions, *copy.global_variables):
        if not value.is_declaration and value.name.startswith(PREFIX):
            value.visibility = "hidden"
        elif not value.is_declaration and value.name != symbol:
            value.linkage = "internal"
    unused = llvm.create_new_module_pass_manager()
    unused.add_global_dead_code_eliminate_pass()
    unused.run(copy, builder)
    return copy


def emitted(module: Any, symbol: str, platform: Platform, level: Level) -> bytes:
    """Return the object file of the optimized module of a symbol for a platform."""
    machine = _machine(symbol, _TRIPLES[platform.system].format(platform.architecture), level)
    copy = llvm.parse_bitcode(module.as_bitcode())
    copy.triple, copy.data_layout = machine.triple, str(machine.target_data)
    if platform.system == "windows" and symbol != ELEMENTARY:
        copy.get_function(symbol).storage_class = "dllexport"
    return bytes(machine.emit_object(copy))


def _machine(symbol: str, triple: str, level: Level) -> Any:
    features = level.features if group_of(symbol) == "lanes" else ""
    return llvm.Target.from_triple(triple).create_target_machine(
        cpu=level.processor, features=features, opt=3, reloc="pic", codemodel="small"
    )


def initialize() -> None:
    """Make all targets of LLVM available."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
