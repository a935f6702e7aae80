"""Statistics of samples: moments, quantiles, sensitivity."""
