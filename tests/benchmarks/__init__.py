"""Programs that print how fast things are: `python -m tests.benchmarks` in the project's folder."""
