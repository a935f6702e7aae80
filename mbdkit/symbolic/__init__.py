"""Every element defined once, at position level, in SymPy; source of ``engine/kernels/element_kernels.py``.

`Mechanism.to_sympy` assembles the equations of a whole mechanism from the same definitions. No simulation imports this
package, except to compile a force law. ``python -m mbdkit.symbolic`` writes the generated file;
``python -m mbdkit.symbolic --check`` checks that the file in the repository is current.
"""
