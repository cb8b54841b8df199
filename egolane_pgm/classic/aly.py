"""Aly's detector (M. Aly: Real time detection of lane markers in urban streets, Intelligent
Vehicles Symposium 2008): ridges from above, RANSAC lines and Bezier splines.

What differs from the paper and its public configuration:

- The view is a region of the road in metres (theirs: of the picture, in pixels), so that it suits
  any calibrated camera. Pictures are first made smaller until their focal length is twice the
  one of their camera, so that lengths in pixels keep their meaning.
- Their tracker is not public. Ours takes its place (`simple.tracking`), with the values of
  their configuration: a line's place may change by 15 pixels of theirs, 1.7 m, from frame to frame
  (the 0.3 rad by which it may turn are more than any line turns); a new line is dropped after three
  frames without detection; and one that is seen in five of ten frames stays valid.
- A spline becomes a line on the road by least squares; its painted share decides whether it is
  dashed, as for the simple detectors (`simple.paint`).
- A spline's score counts no more than the length of the view, and a bent spline is refused before
  it can win: otherwise a loop through two near points beats the marking.

`bezier` lists which keys of the configuration are left out, and which values are not theirs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from egolane_pgm.classic.bezier.picture import refined
from egolane_pgm.classic.bezier.ridges import SIDE_M, ridges, smaller, view_for
from egolane_pgm.classic.bezier.splines import points_on, spline_finder
from egolane_pgm.parameters import Parameters, not_searched
from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import Camera, image_to_road, road_to_image
from egolane_pgm.vision.camera.picture import Image, Picture, as_image, check_size
from egolane_pgm.vision.detectors import FrameLines, Step, fit_shape
from egolane_pgm.vision.detectors.simple.birdseye import look, make_view
from egolane_pgm.vision.detectors.simple.paint import PARAMETERS as _PAINT
from egolane_pgm.vision.detectors.simple.paint import painted_share
from egolane_pgm.vision.detectors.simple.parameters import TRACKING
from egolane_pgm.vision.detectors.simple.tracking import advance, lines_of, no_tracks, rules

STEREO = False

#: How far a line may be from its prediction, metres.
_GATE_M = 1.7

PARAMETERS = not_searched((*_PAINT, *TRACKING))

#: Most lines per picture.
_LINES = 4

#: How far a point of a spline is off its line, metres.
_POINT_SD_M = 0.1

#: Standard deviations of offset, heading (m/m), curvature (1/m) and its rate (1/m^2) of a road. A
#: spline is short, and a cubic through it alone would leave the road before it reaches the car.
_USUAL = (np.inf, 0.03, 1e-3, 3e-5)

#: Range in which paint is searched, metres ahead.
_PAINT_M = (4.5, 25.0)


@dataclass(frozen=True)
class Found:
    """The M lines of one picture, left to right.

    - shape: (M, 4) as in FrameLines
    - from_m, to_m: (M,) where the splines begin and end, metres ahead
    """

    shape: FloatArray
    from_m: FloatArray
    to_m: FloatArray


def line_finder(camera: Camera) -> Callable[[Image], Found]:
    """Make the function that finds the lines in a picture (H, W, 3), blue green red."""
    small = smaller(camera)
    view = view_for(small)
    find_splines = spline_finder()

    def find(image: Image) -> Found:
        check_size(image, camera.width, camera.height)
        red = image[:, :, 2]
        if small is not camera:
            size = small.width, small.height
            red = as_image(cv2.resize(red, size, interpolation=cv2.INTER_AREA))
        control = find_splines(ridges(view, look(view, red)))[:_LINES]
        grey = red.astype(np.float64)
        shape = []
        ends = []
        for point in points_on(control):
            x = view.x_m[0] - point[:, 1] * view.along_m
            y = view.y_m[0] + point[:, 0] * view.across_m
            seen = np.stack(road_to_image(small, x, y), axis=1)
            x, y = image_to_road(small, *refined(grey, small, seen).T)
            shape.append(fit_shape(x, y, _POINT_SD_M, _USUAL))
            ends.append((x.min(), x.max()))
        shapes = np.array(shape).reshape(-1, 4)
        end = np.array(ends).reshape(-1, 2)
        order = np.argsort(shapes[:, 0], kind="stable")
        return Found(shapes[order], *end[order].T)

    return find


def start(camera: Camera, parameters: Parameters) -> Step:
    """Start a drive: the step takes its pictures in order and gives at most four lines.

    Raises InputError if the camera does not see the region of the view.
    """
    find = line_finder(camera)
    rule = rules(parameters, curve="clothoid", gate_m=_GATE_M)
    # Only the pixels along the lines are read, so that a fine view costs nothing.
    near = make_view(camera, *_PAINT_M, -SIDE_M, SIDE_M, along_m=0.1, across_m=0.05)
    tracks = no_tracks(rule)

    def step(picture: Picture) -> FrameLines:
        nonlocal tracks
        shape = find(picture.image).shape
        painted = painted_share(near, picture.image, shape, parameters)
        tracks = advance(tracks, rule, shape, painted)
        return nearest(lines_of(tracks, rule), _LINES)

    return step


def nearest(lines: FrameLines, count: int) -> FrameLines:
    """The `count` lines nearest to the car, valid ones before others."""
    order = np.sort(np.lexsort((np.abs(lines.offset_m), ~lines.is_valid))[:count])
    shape = lines.shape[order]
    lri = lines.lri[order]
    return FrameLines(shape, lines.is_valid[order], lines.is_continuous[order], lri)
