"""Integration methods as data: coefficients, options, claims and references, one method in a file.

The algorithms are in `mbdkit.stepping`. The hash of kernel sources excludes this folder: an edit recompiles nothing.

A file that defines ``FAMILY`` and ``INTEGRATORS`` adds its methods to mbdkit; see `mbdkit.methods.discovery`.
"""
