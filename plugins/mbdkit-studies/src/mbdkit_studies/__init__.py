"""Parameter studies: expansion of a study spec into runs, parallel execution, and an index of the results."""
