"""Muscles as functions of a motion: geometry of their paths, and curves of their forces."""
