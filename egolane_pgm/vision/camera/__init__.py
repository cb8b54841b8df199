"""The camera model, and pictures and videos as files."""
