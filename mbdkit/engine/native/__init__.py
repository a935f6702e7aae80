"""Machine code of the kernels: what kernels are written with, and how their stored code is found, loaded and called.

Nothing in this room imports Numba. The kernels are ordinary Python functions; `mbdkit.engine.compiler` turns them into
the shared libraries in the folder ``stored``, and a run loads those that were built for its processor.
"""
