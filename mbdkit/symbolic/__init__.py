"""Definitions of all elements at position level in SymPy.

``python -m mbdkit_builder elements`` generates ``engine/kernels/element_kernels.py`` from them, and mbdkit-statics
assembles the equations of a whole mechanism for `Mechanism.to_sympy`. A simulation imports this package only for force
laws and contacts.
"""
