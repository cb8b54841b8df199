"""Motorways that do not exist: seeded drives at the level of lines, with everything known."""

from __future__ import annotations

from egolane_pgm.simulation.detector import DetectorModel, detect_lines, sensor_failures
from egolane_pgm.simulation.presets import PRESETS, Drive, Preset, simulate
from egolane_pgm.simulation.world import Road, World, simulate_road

__all__ = [
    "PRESETS",
    "DetectorModel",
    "Drive",
    "Preset",
    "Road",
    "World",
    "detect_lines",
    "sensor_failures",
    "simulate",
    "simulate_road",
]
