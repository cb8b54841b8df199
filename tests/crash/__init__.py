"""Commands that are killed at every one of their calls that change a file."""
