"""Simulated motorways: seeded drives as lists of lines, with their ground truth.
`vision.simulated` draws the same drives as pictures."""

from __future__ import annotations

from egolane_pgm.simulation.detector import (
    PRESETS,
    DetectorModel,
    Preset,
    SimulatedDrive,
    detect_lines,
    sensor_failures,
    simulate,
    simulated_road,
)
from egolane_pgm.simulation.world import Road, World, simulate_road

__all__ = [
    "PRESETS",
    "DetectorModel",
    "Preset",
    "Road",
    "SimulatedDrive",
    "World",
    "detect_lines",
    "sensor_failures",
    "simulate",
    "simulate_road",
    "simulated_road",
]
