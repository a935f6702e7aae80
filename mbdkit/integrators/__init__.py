"""Integrators: tableaus as exact data, one stepping algorithm a family, and the bridge to SciPy's solvers."""
