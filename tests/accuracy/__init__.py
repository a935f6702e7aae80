"""Estimated errors of runs."""
