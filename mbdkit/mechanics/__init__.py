"""What a mechanism tells without a run: where it rests, how it swings there, and how its drivers move it."""
