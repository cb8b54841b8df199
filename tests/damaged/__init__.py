"""Each reader on files that somebody damaged: `python -m tests.damaged`."""
