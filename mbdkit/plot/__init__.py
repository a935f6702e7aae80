"""Plots and videos of runs, drawn by Matplotlib from recorded data."""
