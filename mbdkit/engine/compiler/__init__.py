"""The compiler of the kernels: Numba and LLVM turn their sources into the stored machine code.

Only ``python -m mbdkit.engine.compiler`` imports this room, and force laws that are functions of plugins. Runs load the
stored code (`mbdkit.engine.native`).
"""
