"""Force laws that are functions of plugins: Numba compiles them, in every process that uses them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from numba import carray, cfunc, njit, types  # type: ignore[attr-defined]
from numba.extending import intrinsic, is_jitted

from mbdkit.base.errors import PluginError
from mbdkit_builder import call_code
from mbdkit_builder.dual_arrays import DualArray
from mbdkit_builder.dual_types import DUAL

_POINTER = types.CPointer(types.float64)
_OF_NUMBERS = types.void(types.int64, types.float64, types.float64, types.float64, _POINTER, _POINTER)
_OF_DUALS = types.void(types.int64, _POINTER, _POINTER, types.float64, _POINTER, _POINTER)
#: Type of the parameters passed to a law: they belong to the mechanism, so a law that changes them is not compiled.
_PARAMETERS = types.Array(types.float64, 1, "C", readonly=True)


def _read_only_typing(typing, array):
    def generate(context, builder, signature, arguments):
        return arguments[0]

    return _PARAMETERS(array), generate


_read_only: Any = intrinsic(_read_only_typing)


def _dual_at_typing(typing, pointer, index):
    def generate(context, builder, signature, arguments):
        return DualArray.load(builder, DualArray.behind(builder, *arguments))

    return DUAL(_POINTER, types.int64), generate


_dual_at: Any = intrinsic(_dual_at_typing)


def _put_dual_typing(typing, pointer, index, x):
    def generate(context, builder, signature, arguments):
        DualArray.store(builder, arguments[2], DualArray.behind(builder, *arguments[:2]))
        return context.get_dummy_value()

    return types.void(_POINTER, types.int64, DUAL), generate


_put_dual: Any = intrinsic(_put_dual_typing)


def _duals_behind_typing(typing, pointer, count):
    kind = DualArray(1)

    def generate(context, builder, signature, arguments):
        return call_code.array_at(context, builder, kind, DualArray.behind(builder, arguments[0], 1), arguments[1])

    return kind(_POINTER, types.int64), generate


_duals_behind: Any = intrinsic(_duals_behind_typing)


@cache
def compiled_function(function: Callable[..., Any], *, duals: bool) -> Any:
    """Return a law's function as C callback with an attribute ``address``; see `mbdkit.engine.native.calls`.

    Parameters
    ----------
    function
        The law in Python.
    duals
        Whether to compile it for dual numbers.

    Raises
    ------
    PluginError
        If the function does not return four numbers; not checked for dual numbers.
    """
    law: Any = function if is_jitted(function) else njit(function, error_model="numpy", forceinline=True)
    return _for_duals(law) if duals else _for_numbers(law)


def _for_numbers(law: Any) -> Any:
    _check_results(law)

    @cfunc(_OF_NUMBERS, error_model="numpy")
    def entry(program, length, rate, time, parameters, out):
        """Write force, its derivatives with respect to length and rate, and the potential; all stay NaN if the law
        raises.
        """
        results = carray(out, (4,))
        results[0] = results[1] = results[2] = results[3] = _NAN
        count = int(carray(parameters, (1,))[0])
        force, by_length, by_rate, potential = law(length, rate, time, _read_only(carray(parameters, (count + 1,))[1:]))
        results[0] = force
        results[1] = by_length
        results[2] = by_rate
        results[3] = potential

    return entry


def _for_duals(law: Any) -> Any:
    @cfunc(_OF_DUALS, error_model="numpy")
    def entry(program, length, rate, time, parameters, out):
        """Write force, its derivatives with respect to length and rate, and the potential, each as a dual number with
        derivatives with respect to parameters.
        """
        for i in range(4):
            _put_dual(out, i, _NAN)
        count = int(_dual_at(parameters, 0))
        force, by_length, by_rate, potential = law(
            _dual_at(length, 0), _dual_at(rate, 0), time, _duals_behind(parameters, count)
        )
        _put_dual(out, 0, force)
        _put_dual(out, 1, by_length)
        _put_dual(out, 2, by_rate)
        _put_dual(out, 3, potential)

    return entry


_NAN = float("nan")


def _check_results(law: Any) -> None:
    """Raise PluginError unless the function returns four numbers."""
    arguments = (types.float64, types.float64, types.float64, _PARAMETERS)
    law.compile(arguments)
    returned = law.overloads[arguments].signature.return_type
    numbers = list(getattr(returned, "types", [returned]))  # the elements of a tuple
    if len(numbers) == 4 and all(isinstance(one, types.Number | types.Boolean) for one in numbers):
        return
    found = "one value" if len(numbers) == 1 else f"{len(numbers)} values" if len(numbers) != 4 else "other types"
    raise PluginError(
        f"its function returns {found}, not the four numbers force, derivative with respect to length, derivative with "
        "respect to rate and potential: return all four, or write the law as a SymPy expression, whose derivatives are "
        "computed"
    )
