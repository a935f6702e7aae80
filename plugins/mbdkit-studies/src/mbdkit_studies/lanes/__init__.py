"""Runs that are computed together in vectorized lanes."""
