"""Calls by address in compiled code: of entries (`mbdkit.engine.native.functions`), and of force laws.

A law is a C function ``void law(int64 program, double length, double rate, double time, const double *parameters,
double *out)``. It writes the force, its derivatives with respect to length and rate, and the potential into
``out[0..3]``; ``parameters[0]`` is the number of parameters that follow, and ``program`` the address of further data of
the law (`mbdkit.engine.kernels.law_programs`). The laws of interactions (`Topology.interactions`) write other
numbers. Kernels read the addresses of the law and of its program from an array, so that they need not be compiled again
for a new law.

Laws for dual numbers have the same arguments, but all numbers except the time are addresses of dual numbers.
"""

from __future__ import annotations

import ctypes

import numpy as np

from mbdkit.engine.native.functions import placeholder
from mbdkit.engine.native.kernel import entry_in_python

#: Bits of the claims of a law. HAS_POTENTIAL: the force at zero rate is the derivative of the potential with respect to
#: length. PASSIVE: all power that is not stored as potential energy is dissipated.
HAS_POTENTIAL, PASSIVE = 1, 2

#: The C function of a law.
LAW = ctypes.CFUNCTYPE(
    None, ctypes.c_int64, ctypes.c_double, ctypes.c_double, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p
)


@placeholder
def call_entry(address, first, second, t, h, x):
    """Call the entry at `address` with its five arguments; returns its status."""
    return entry_in_python(address)(first, second, t, h, x)


@placeholder
def call_law(address, program, length, rate, time, parameters, begin, out, row, count):
    """Call the law at `address` with `parameters` (N,) from index `begin` on.

    It writes row `row` of `out` (K, count), or several rows from this one on; `count` is a constant. In lanes,
    `parameters` are (WIDTH, N), and the law is called for one lane after the other.
    """
    LAW(int(address))(int(program), length, rate, time, parameters[begin:].ctypes.data, out[row].ctypes.data)


@placeholder
def integers_at(address, count):
    """Return the `count` integers at an address as an array."""
    return np.ctypeslib.as_array((ctypes.c_int64 * count).from_address(address))


@placeholder
def numbers_at(address, first, count, like):
    """Return an array of `count` numbers that begins with number `first` at an address; duals if `like` is one."""
    return np.ctypeslib.as_array((ctypes.c_double * count).from_address(address + 8 * first))


@placeholder
def new_registers(count, like):
    """Return an array of `count` numbers, a constant, on the stack of the calling function; duals if `like` is one."""
    return np.zeros(count)
