"""Events: expressions over a run, and the instants at which they cross zero."""
