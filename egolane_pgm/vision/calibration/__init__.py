"""Calibration: how a camera looks at the road, found from its pictures."""
