"""From markers to the motion of a mechanism: fit, gaps, smoothing, reduced coordinates."""
