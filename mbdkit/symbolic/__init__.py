"""Every element defined once, at position level, in SymPy; source of ``engine/kernels/element_kernels.py``.

From the same definitions `Mechanism.to_sympy` puts the equations of a whole mechanism together. Nothing here is
imported while a simulation runs. ``python -m mbdkit.symbolic`` writes the generated file anew,
``python -m mbdkit.symbolic --check`` says whether the one that is checked in is fresh.
"""
