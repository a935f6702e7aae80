"""Stepping: the compiled step of each kind of method, the driver that repeats it, Python methods, SciPy solvers."""
