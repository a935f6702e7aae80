"""All code that depends on Numba: compilation, the cache of compiled kernels, and calls by address."""
