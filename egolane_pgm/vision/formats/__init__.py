"""Lines of labelled pictures, in pixels: made metres by a camera."""
