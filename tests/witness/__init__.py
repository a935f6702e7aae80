"""Outside witnesses: reference solutions that share no code with mbdkit, and the tests that hold mbdkit to them."""
