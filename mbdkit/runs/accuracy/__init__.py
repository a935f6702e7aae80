"""Estimates of the error of a run, from comparison runs (companions) of the same mechanism."""
