"""Stepping: the compiled step of each kind of method, the step loop that repeats it, Python methods, SciPy solvers."""
