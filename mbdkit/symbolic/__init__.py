"""Definitions of all elements at position level in SymPy, and the code generator that uses them.

``python -m mbdkit.symbolic`` generates ``engine/kernels/element_kernels.py``; ``python -m mbdkit.symbolic --check``
checks that the file in the repository is current. `Mechanism.to_sympy` of mbdkit-statics assembles the equations of a
whole mechanism from the same definitions. A simulation imports this package only for force laws and contacts.
"""
