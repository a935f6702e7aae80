"""Kernels of rigid contacts, whose machine code is stored beside this folder."""
