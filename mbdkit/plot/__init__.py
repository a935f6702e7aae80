"""Figures and animations of runs: pure functions of recorded data that draw on Matplotlib axes."""
