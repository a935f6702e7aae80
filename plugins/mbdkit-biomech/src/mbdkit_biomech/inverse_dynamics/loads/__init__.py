"""Forces and moments of measured loads, and the dynamics of the motion."""
