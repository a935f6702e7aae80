"""Many runs side by side in vectorized lanes."""
