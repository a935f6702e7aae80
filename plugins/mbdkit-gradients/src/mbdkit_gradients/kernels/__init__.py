"""Kernels of adjoint gradients, whose machine code is stored beside this folder."""
