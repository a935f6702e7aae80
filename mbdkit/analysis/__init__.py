"""What runs say: drift and how it grows, order, energy, error, cost, and verdicts on them; functions without state."""
