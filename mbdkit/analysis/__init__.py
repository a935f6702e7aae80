"""Analysis of runs: joint drift and its growth, observed order, energy, error and cost, and the verdicts on them."""
