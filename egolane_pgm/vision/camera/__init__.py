"""Cameras and what they see: the camera model, and pictures and videos as files."""
