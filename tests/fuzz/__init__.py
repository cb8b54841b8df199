"""Each reader against files that were damaged at random, by a seed: `python -m tests.fuzz`."""
