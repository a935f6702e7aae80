"""What happens in a run: preparation, the host of the step loop, recording, evidence, checks, checkpoints, lanes."""
