"""The packaged study `no-drift`: misalignment over 100,000 steps."""
