"""Integration methods as data: tableaus with exact coefficients, options, claims and references; no kernels."""
