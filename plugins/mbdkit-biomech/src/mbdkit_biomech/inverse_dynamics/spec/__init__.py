"""What a spec of inverse dynamics says."""
