"""Speed and memory, as tables: `python -m tests.benchmarks`. No test is timed; those here are of what the tables rest on."""
