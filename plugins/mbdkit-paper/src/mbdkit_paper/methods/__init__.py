"""Problems of others, with published results, on which integrators of constrained mechanics are compared."""
