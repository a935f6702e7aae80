"""Run archives, one HDF5 file per run: layout, writing, reading, checking and comparison."""
