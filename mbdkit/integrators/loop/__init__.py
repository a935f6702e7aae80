"""The loop of a compiled run: steps, their control, projections, failures."""
