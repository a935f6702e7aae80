"""Mathematics of sampled signals: filters, splines, cycles, distributions."""
