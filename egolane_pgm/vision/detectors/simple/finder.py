"""The paper's "simple" line detector and tracker (section `section:simple-line-detector`).

Its four variants have one or two cameras, and fit straight lines or clothoids.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from egolane_pgm.parameters import Parameters, not_searched
from egolane_pgm.types import BoolArray, FloatArray
from egolane_pgm.vision.camera.model import LANE_WIDTHS, Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, Step
from egolane_pgm.vision.detectors.simple import drift
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, turned_up
from egolane_pgm.vision.detectors.simple.fit import Found, find_lines, view_for
from egolane_pgm.vision.detectors.simple.paint import PARAMETERS as _PAINT
from egolane_pgm.vision.detectors.simple.paint import painted_share
from egolane_pgm.vision.detectors.simple.parameters import FINDING, TRACKING
from egolane_pgm.vision.detectors.simple.tracking import (
    Rules,
    Tracks,
    advance,
    expected,
    gaps_beyond,
    lines_of,
    no_tracks,
    rules,
)

#: The parameters of all variants, each of which sets `curve`, and of those with one camera.
PARAMETERS = not_searched((*(p for p in FINDING if p.name != "curve"), *_PAINT, *TRACKING))
MONO = (*PARAMETERS, *drift.PARAMETERS)

#: The number of frames with a line a lane beyond the edge of the road for a warning.
_BEYOND_FRAMES = 50

#: From a picture of both cameras to the bird's-eye view with the camera's pitch in this frame, and
#: its pixels (R, C) on the plane of the road.
OnRoad = Callable[[Picture], tuple[BirdsEye, BoolArray]]

#: From a view, a picture and the predicted lines (P, 4) or None to the lines of the picture.
Finder = Callable[[BirdsEye, Picture, FloatArray | None], Found]


def start(camera: Camera, parameters: Parameters, **given: Any) -> Step:
    """Start a drive, as the `start` of a detector; `given` as in `follower`."""
    follow, rule = follower(camera, parameters, **given)
    tracks = no_tracks(rule)
    n_beyond = 0

    def step(picture: Picture) -> FrameLines:
        nonlocal tracks, n_beyond
        tracks = follow(tracks, picture)
        lines = lines_of(tracks, rule)
        gaps = gaps_beyond(tracks, lines)
        n_beyond += bool(((gaps > LANE_WIDTHS[0]) & (gaps < LANE_WIDTHS[1])).any())
        if n_beyond == _BEYOND_FRAMES:
            n_beyond += 1
            warnings.warn(
                f"frame {picture.frame_id}: doubtful: in {_BEYOND_FRAMES} frames a line was a"
                " lane beyond the continuous one that is taken for the edge of the road; if a lane"
                " lies between (another lane, or the other direction of a two-way road), set"
                " beyond_edge to keep",
                stacklevel=2,
            )
        return lines

    return step


def follower(
    camera: Camera,
    parameters: Parameters,
    *,
    curve: str,
    on_road: Callable[[BirdsEye, Parameters], OnRoad] | None = None,
    finder: Finder | None = None,
) -> tuple[Callable[[Tracks, Picture], Tracks], Rules]:
    """Return the function from the tracks and the next picture to the tracks, and its rules.

    - curve: "line", "parabola" or "clothoid"
    - on_road: makes the separation of the road from the objects on it; by default all is road
    - finder: finds the lines of a frame; by default the search in its markings

    Raises InputError if the camera does not show the region that the parameters ask for.
    """
    parameters = {**parameters, "curve": curve}
    rule = rules(parameters, curve=curve)
    view = view_for(camera, parameters)
    road = None if on_road is None else on_road(view, parameters)
    # With two cameras the plane of the road gives the pitch.
    is_watched = road is None and parameters["camera_drift"] == "correct"
    watch = drift.watch(view, parameters) if is_watched else None
    turned = turned_up(view)
    corrected_deg = 0.0

    def follow(tracks: Tracks, picture: Picture) -> Tracks:
        nonlocal corrected_deg
        seen, is_road = (view, None) if road is None else road(picture)
        if watch is not None:
            before = corrected_deg
            corrected_deg = watch(picture).correction_deg
            # Lines to either side of the car turn outwards (the squeeze of `fit`).
            mean = tracks.mean.copy()
            mean[:, 1] += math.radians(corrected_deg - before) / camera.height_m * mean[:, 0]
            tracks = replace(tracks, mean=mean)
            seen = turned(corrected_deg)
        prior = expected(tracks)
        prior_shape = prior if len(prior) else None
        found = (
            find_lines(seen, picture.image, parameters, prior_shape=prior_shape, on_road=is_road)
            if finder is None
            else finder(seen, picture, prior_shape)
        )
        painted = painted_share(seen, picture.image, found.shape, parameters)
        if found.solid is not None:
            painted = np.where(np.isnan(found.solid), painted, found.solid)
        return advance(tracks, rule, found.shape, painted, found.likely)

    return follow, rule
