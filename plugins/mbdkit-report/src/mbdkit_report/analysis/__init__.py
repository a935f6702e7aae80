"""Analysis of runs: growth of misalignment, energy, observed order, cost, cycles, workload, and verdicts of studies."""
