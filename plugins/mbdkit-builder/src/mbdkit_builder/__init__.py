"""The compiler of the kernels: Numba and LLVM turn their sources into the stored machine code.

This package is imported by ``python -m mbdkit_builder``, and to compile force laws that are functions of plugins. All
other runs load the stored code (`mbdkit.engine.native`) without it.
"""
