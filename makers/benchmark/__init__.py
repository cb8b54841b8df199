"""The public board of the benchmark."""
