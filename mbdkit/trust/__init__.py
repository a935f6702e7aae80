"""Verdicts on runs: the criteria, and the quantities that they are applied to."""
