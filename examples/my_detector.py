"""An own detector: the two brightest strips of road, one on either side of the car.

It knows no dashes and no curves, and follows nothing: a line is detected again where it was.
"""

from collections import deque

import cv2
import numpy as np

from egolane_pgm.parameters import Parameter
from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.detectors import FrameLines

STEREO = False
PARAMETERS = (
    Parameter("contrast", "positive", 8.0, "grey levels that a line is brighter than the road"),
    Parameter("frames", "integer", 10, "a line is valid when found in so many frames", lowest=1),
    Parameter("hold", "probability", 0.5, "and until found in less than this share of them"),
)


def start(camera, parameters):
    offsets = np.arange(-6.0, 6.0, 0.1)
    ahead = np.linspace(6.0, 25.0, 60)
    u, v = road_to_image(camera, ahead[:, None], offsets)
    look_at = u.astype(np.float32), v.astype(np.float32)
    sides = {side: deque(maxlen=parameters["frames"]) for side in ("left", "right")}
    place, is_valid = {}, dict.fromkeys(sides, False)

    def step(picture):
        grey = cv2.cvtColor(picture.image, cv2.COLOR_BGR2GRAY)
        strips = cv2.remap(grey, *look_at, cv2.INTER_LINEAR).mean(axis=0)
        bright = strips - cv2.blur(strips[None], (31, 1))[0]
        lines = []
        for side, hits in sides.items():
            here = np.where((offsets < 0) == (side == "left"), bright, -np.inf)
            at = int(np.argmax(here))
            hits.append(bool(here[at] > parameters["contrast"]))
            if hits[-1]:
                place[side] = offsets[at]
            lri, most = sum(hits), parameters["frames"]
            is_valid[side] = lri == most or (is_valid[side] and lri >= parameters["hold"] * most)
            if lri:
                lines.append(([place[side], 0.0, 0.0, 0.0], is_valid[side], lri))
        return FrameLines(
            np.array([shape for shape, _, _ in lines]).reshape(-1, 4),
            np.array([valid for _, valid, _ in lines], dtype=bool),
            np.zeros(len(lines), dtype=bool),
            np.array([lri for _, _, lri in lines], dtype=float),
        )

    return step
