"""Measures: numbers computed from a run by expressions or plugins."""
