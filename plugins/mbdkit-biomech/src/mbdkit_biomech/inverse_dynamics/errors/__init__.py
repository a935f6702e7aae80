"""Noise of the data and the error bars of what is computed from them."""
