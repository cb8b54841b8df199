"""The algorithms once more, as plainly as they can be written: what the fast paths are held to."""
