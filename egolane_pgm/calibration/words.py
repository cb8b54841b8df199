"""How a camera was calibrated, in words: the comment of its file."""

from __future__ import annotations

import numpy as np

from egolane_pgm.calibration.chessboard import Lens
from egolane_pgm.calibration.straight_road import RoadView


def lens_words(lens: Lens, board: str) -> list[str]:
    """Lines about a lens from chessboards."""
    n_pictures = len(lens.boards) + len(lens.skipped)
    best, worst = min(lens.rms_px), max(lens.rms_px)
    return [
        f"Lens: {len(lens.boards)} chessboards ({board} inner corners) of {n_pictures} pictures,"
        f" {lens.overall_rms_px:.2f} px RMS",
        f"  ({best:.2f} to {worst:.2f} px from board to board).",
    ]


def assumed_words(field_of_view_deg: float) -> list[str]:
    """Lines about a lens that nobody has measured."""
    return [
        f"Lens: not measured; a horizontal field of view of {field_of_view_deg:g} degrees assumed,"
        " no distortion",
        "  (offsets hardly depend on it, distances ahead do).",
    ]


def road_words(view: RoadView, what: str) -> list[str]:
    """Lines about the view of the road; what: the lines used, e.g. '55 labelled frames'."""
    u, v = view.vanishing_point
    du, dv = view.spread_px
    lanes = view.gaps_m[view.is_lane]
    return [
        f"Road: {what}.",
        f"  They meet at ({u:.1f}, {v:.1f}) px of the undistorted picture, give or take"
        f" ({du:.1f}, {dv:.1f}) px in {len(view.vanishing_points)} frames.",
        f"Height: from a lane width of {view.lane_width_m:g} m; {len(lanes)} of"
        f" {len(view.gaps_m)} gaps between neighbouring lines are lanes",
        f"  (standard deviation {np.std(lanes):.2f} m; those near the car count most).",
    ]
