"""Reference solutions that share no code with mbdkit, and the tests that compare mbdkit with them."""
