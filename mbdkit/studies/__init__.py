"""Studies: families of runs over a base spec, expanded, executed by several processes, and collected in one index."""
