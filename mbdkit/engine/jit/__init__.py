"""Everything that depends on the internals of Numba: compilation, its cache, and calls by address."""
