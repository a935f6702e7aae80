"""What the results of a study say: selections, costs, verdicts."""
