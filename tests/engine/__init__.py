"""Tests of the engine: kernels, solvers, assembly and cache against independent dense formulas."""
