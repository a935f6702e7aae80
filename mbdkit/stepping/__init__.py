"""Stepping: the compiled step of each family of methods, the driver that repeats it, Python methods, SciPy solvers."""
