"""The engine: a compiled mechanism as flat arrays, and the kernels that assemble, solve and observe it."""
