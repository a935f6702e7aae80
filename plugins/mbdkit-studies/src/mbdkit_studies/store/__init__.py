"""Where the results of points are kept: the index, blocks and archives of runs."""
