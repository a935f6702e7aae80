"""Execution of runs: preparation, the step loop, recording, evidence, accuracy checks, checkpoints, vectorized runs."""
