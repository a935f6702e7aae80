"""Measures: numbers that expressions or plugins take from a run."""
