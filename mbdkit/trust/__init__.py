"""Verdicts on runs: the criteria, and the numbers to which they are applied."""
