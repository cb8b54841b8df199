"""MLD: one camera, four or six lines at most (Hur, Kang and Seo, *Multi-lane detection in urban
driving environments using conditional random fields*, IEEE Intelligent Vehicles Symposium 2013).

Written from a description of the published program and its constants. What differs: widths of
markings and the rows that are searched follow from the camera, constants in pixels are scaled by
the picture's width (1280) or by the rows searched (454); the gaps between lines are metres; only a
common motion sideways and a common turn are taken over from clear lines to the others; a line
needs 120 markings to be clear, not 60; and each link of the CRF is merged by its own
label (see `multilane.crf`).

MLD does not distinguish continuous from dashed lines. A line is a parabola in the picture, as
published, but not on the road: in a bend, it is too straight beyond 20 m ahead, and
its curvature is too small.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np

from egolane_pgm.classic.multilane import curves
from egolane_pgm.classic.multilane.crf import join_seeds
from egolane_pgm.classic.multilane.markings import Markings, find_markings
from egolane_pgm.classic.multilane.road import Road, road_of, shapes_of
from egolane_pgm.classic.multilane.slots import SPAN, Slots, advance, no_slots
from egolane_pgm.parameters import Parameter, Parameters, not_searched, number
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Picture, as_image, check_size
from egolane_pgm.vision.detectors import FrameLines, Step

STEREO = False
PARAMETERS = not_searched(
    (
        Parameter(
            "lines",
            "integer",
            4,
            "how many lines are followed: 2, the lane's own; 4, their neighbours too; 6 at most",
            lowest=2,
            highest=6,
        ),
    )
)

#: Distance ahead up to which lines are searched, metres.
_REACH_M = 55.0

#: Width of the narrowest marking, metres.
_NARROWEST_M = 0.078

#: Width of the widest marking, metres; the authors' pixels are .23 for TuSimple's camera.
_WIDEST_M = 0.3

#: A line is shown when it was seen in more than this many of the last 10 pictures.
SHOWN_ABOVE = 3

#: A line starts only where its markings fill this share of its rows (the authors': .382; dashes of
#: a motorway fill less).
_FILLED = 0.1

#: Groups of at most this many links of the CRF are solved exactly, larger ones by turning each link
#: on in turn, as published.
_EXACT_UP_TO = 10

#: A line starts from a curve that covers at least this number of rows.
_ROWS = 50

#: Largest heading on the road of a line's first curve, m/m.
_HEADING = 0.15

#: Largest curvature on the road of a line's first curve, 1/m.
_CURVATURE = 0.01


def start(camera: Camera, parameters: Parameters) -> Step:
    """Start a drive: the step takes its pictures in order and gives lines.

    Raises InputError if the camera sees too little of the road.
    """
    road = road_of(camera, _REACH_M, _NARROWEST_M, _WIDEST_M)
    most = int(number(parameters, "lines"))
    rng = np.random.default_rng(0)
    slots = no_slots()

    def step(picture: Picture) -> FrameLines:
        nonlocal slots
        check_size(picture.image, camera.width, camera.height)
        grey = cv2.cvtColor(picture.image, cv2.COLOR_BGR2GRAY)
        markings = find_markings(as_image(grey), road)
        t, u = markings.points(road)
        found = starts(road, join_seeds(markings, road, _EXACT_UP_TO))
        slots = advance(slots, road, t, u, found, most, rng)
        return lines_of(slots, road)

    return step


def starts(road: Road, joined: Markings) -> FloatArray:
    """The curves (C, 3) of the joined seeds of a picture from which lines may start."""
    t, u = joined.points(road)
    long = []
    for first, stop in pairwise(joined.starts.tolist()):
        rows = joined.row[stop - 1] - joined.row[first] + 1
        if rows >= _ROWS * road.row_scale and stop - first >= _FILLED * rows:
            of = slice(first, stop)
            long.append(curves.fit(t[of], u[of], 2 if np.ptp(t[of]) > SPAN else 1))
    curve: FloatArray = np.array(long).reshape(-1, 3)
    _, heading, curvature, _ = shapes_of(road, curve).T
    is_road = (np.abs(heading) <= _HEADING) & (np.abs(curvature) <= _CURVATURE)
    good: FloatArray = curve[is_road]
    return good


def lines_of(slots: Slots, road: Road) -> FrameLines:
    """Return the output of the detector for a frame, lines from left to right."""
    slot = np.flatnonzero(slots.is_used)
    shape = shapes_of(road, slots.curve[slot])
    counter = slots.counter[slot]
    is_valid = counter > SHOWN_ABOVE
    order = np.argsort(shape[:, 0], kind="stable")
    return FrameLines(
        shape[order],
        is_valid[order],
        np.zeros(len(order), dtype=bool),
        counter[order],
    )
