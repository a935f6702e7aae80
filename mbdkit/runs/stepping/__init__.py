"""Simulations that a program advances step by step."""
