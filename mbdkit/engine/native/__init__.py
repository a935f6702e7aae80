"""Machine code of the kernels: the functions with which kernels are written; loading and calling of their stored code.

Nothing in this package imports Numba. The kernels are ordinary Python functions; `mbdkit_builder` turns them
into the shared libraries in the folder ``stored``, and a run loads those that were built for its processor.
"""
