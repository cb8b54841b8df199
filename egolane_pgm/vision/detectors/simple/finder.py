"""The paper's "simple" line detector and tracker (section `section:simple-line-detector`), as its
four variants share it: with one or two cameras, for straight lines or clothoids."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from egolane_pgm.parameters import Parameters
from egolane_pgm.types import BoolArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines, Step
from egolane_pgm.vision.detectors.networks.finding import PARAMETERS as _NETWORK
from egolane_pgm.vision.detectors.networks.finding import Finder, keep_on_road
from egolane_pgm.vision.detectors.simple import drift
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye, turned_up
from egolane_pgm.vision.detectors.simple.fit import find_lines, view_for
from egolane_pgm.vision.detectors.simple.paint import PARAMETERS as _PAINT
from egolane_pgm.vision.detectors.simple.paint import painted_share
from egolane_pgm.vision.detectors.simple.parameters import FINDING, TRACKING
from egolane_pgm.vision.detectors.simple.tracking import (
    Rules,
    Tracks,
    advance,
    expected,
    lines_of,
    no_tracks,
    rules,
)

PARAMETERS = (
    # Each variant sets `curve` itself.
    *(p for p in FINDING if p.name != "curve"),
    *_PAINT,
    *TRACKING,
    *drift.PARAMETERS,
    *_NETWORK,
)

#: Takes a picture of both cameras; gives the bird's-eye view with the camera's pitch in this frame,
#: and which of its pixels (R, C) lie on the plane of the road.
OnRoad = Callable[[Picture], tuple[BirdsEye, BoolArray]]

#: Makes, for a camera, a function that makes it for a view.
MakeOnRoad = Callable[[Camera, Parameters], Callable[[BirdsEye], OnRoad]]


def start(
    camera: Camera,
    parameters: Parameters,
    *,
    curve: str,
    on_road: MakeOnRoad | None = None,
    finder: Finder | None = None,
) -> Step:
    """The `start` of a detector.

    - curve: "line", "parabola" or "clothoid"
    - on_road: makes what separates the road from the objects on it; None if all pixels count as
      road
    - finder: what finds the lines of a frame; None for the search in its markings

    Raises InputError if the camera does not see the region that the parameters ask for.
    """
    follow, rule = follower(camera, parameters, curve=curve, on_road=on_road, finder=finder)
    tracks = no_tracks(rule)

    def step(picture: Picture) -> FrameLines:
        nonlocal tracks
        tracks = follow(tracks, picture)
        return lines_of(tracks, rule)

    return step


def follower(
    camera: Camera,
    parameters: Parameters,
    *,
    curve: str,
    on_road: MakeOnRoad | None = None,
    finder: Finder | None = None,
) -> tuple[Callable[[Tracks, Picture], Tracks], Rules]:
    """As `start`, but the step takes the tracks and gives the new ones. Also gives its rules."""
    parameters = {**parameters, "curve": curve}
    rule = rules(parameters, curve=curve)
    for_view = None if on_road is None else on_road(camera, parameters)
    view = view_for(camera, parameters)
    road = None if for_view is None else for_view(view)
    keep = keep_on_road(camera, parameters)
    if road is not None and parameters["camera_drift"] == "correct":
        # The plane of the road corrects the pitch.
        parameters = {**parameters, "camera_drift": "warn"}
    watch = None if parameters["camera_drift"] == "ignore" else drift.watch(view, parameters)
    corrects = parameters["camera_drift"] == "correct"
    turned, corrected_deg = turned_up(view), 0.0

    def follow(tracks: Tracks, picture: Picture) -> Tracks:
        nonlocal corrected_deg
        # A stereo pair is checked first, so that its own errors name the picture that is wrong.
        seen, is_road = (view, None) if road is None else road(picture)
        believed = None if watch is None else watch(picture)
        if believed is not None and corrects:
            before, corrected_deg = corrected_deg, drift.correction_deg(believed)
            tracks = _turned(tracks, corrected_deg - before, camera)
            seen = turned(corrected_deg)
        if keep is not None:
            kept = keep(seen, picture)
            is_road = kept if is_road is None else is_road & kept
        prior = expected(tracks)
        prior_shape = prior if len(prior) else None
        found = (
            find_lines(seen, picture.image, parameters, prior_shape=prior_shape, on_road=is_road)
            if finder is None
            else finder(seen, picture, prior_shape, is_road)
        )
        painted = painted_share(seen, picture.image, found.shape, parameters)
        if found.solid is not None:
            painted = np.where(np.isnan(found.solid), painted, found.solid)
        return advance(tracks, rule, found.shape, painted, found.likely)

    return follow, rule


def _turned(tracks: Tracks, more_deg: float, camera: Camera) -> Tracks:
    """The tracks as seen by a camera that is pitched up by `more_deg`: lines beside the car turn
    outwards (the squeeze of `fit`)."""
    if not more_deg:
        return tracks
    mean = tracks.mean.copy()
    mean[:, 1] += math.radians(more_deg) / camera.height_m * mean[:, 0]
    return replace(tracks, mean=mean)
