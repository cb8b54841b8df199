"""Calibration: lens, angles and height of a camera from its pictures."""
