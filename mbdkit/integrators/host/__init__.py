"""The side of a method written in Python: its rows, energies, last step and projections."""
