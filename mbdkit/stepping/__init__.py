"""Stepping: a compiled step for each family of methods, the driver that repeats it, and methods in Python and SciPy."""
