"""The room of the run archive: one HDF5 file a run, its layout, how it is written, read, checked and compared."""
