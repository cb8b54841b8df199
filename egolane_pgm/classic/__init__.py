"""Detectors of 2008 and 2013, rebuilt: Aly's, and the multi-lane detector."""
