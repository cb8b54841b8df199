"""Simulated motorways: seeded drives as lists of lines, with their ground truth.
`vision.simulated` draws the same drives as pictures."""

from __future__ import annotations

from egolane_pgm.simulation.detector import PRESETS, SimulatedDrive, simulate, simulated_road
from egolane_pgm.simulation.world import Road

__all__ = ["PRESETS", "Road", "SimulatedDrive", "simulate", "simulated_road"]
