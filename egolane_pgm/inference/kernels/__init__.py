"""The compiled recursions."""
