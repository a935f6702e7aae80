"""Speed and memory, as tables: `python -m tests.benchmarks`. Nothing here is a test, and no test is timed."""
