"""Estimates of the error of a run, from companion runs of the same mechanism."""
