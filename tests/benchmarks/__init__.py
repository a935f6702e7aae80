"""Speed and memory, as tables: `python -m tests.benchmarks`. No test here is timed; they are of what tables rest on."""
