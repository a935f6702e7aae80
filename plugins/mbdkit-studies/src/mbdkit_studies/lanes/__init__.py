"""Runs of one spec with other numbers, prepared once."""
