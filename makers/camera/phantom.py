"""A vehicle whose edges became a line inside the lane, before and after vehicles are looked for:
one of the first 55 stills of `tusimple`, for the eye.

Before is the finder with `shadow_share: 0`, after with its default.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.vision.camera.model import Camera, road_to_image
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.detectors.simple.birdseye import BirdsEye
from egolane_pgm.vision.detectors.simple.fit import Found, find_lines, from_above, view_for
from egolane_pgm.vision.detectors.simple.parameters import FINDING
from egolane_pgm.vision.detectors.simple.upright import free_road
from makers.camera import tusimple
from makers.camera._labels import label_picture, read_labels

#: The still that is drawn.
DRAWN = 12

_WAYS = (("vehicles not looked for", {"shadow_share": 0.0}), ("vehicles looked for", {}))
_RIGHT, _WRONG, _HIDDEN = (90, 220, 60), (60, 60, 255), (200, 90, 0)


def measure() -> list[str]:
    """The figures as Markdown, or one line that says what is absent."""
    labels = tusimple.data_file()
    if labels is None:
        return [f"Phantom lines: {tusimple.FILE} is absent (EGOLANE_DATA)."]
    first = slice(0, tusimple.HALF)
    lines = [
        "### Lines that vehicles make",
        "",
        "The first 55 stills (in-sample), as in `tusimple`.",
        "",
        "| fitted | vehicles | recall | precision |",
        "|---|---|---|---|",
    ]
    for curve in ("clothoid", "line"):
        for name, given in _WAYS:
            stills = tusimple.look_at(labels, first, curve=curve, **given)
            recall, precision = tusimple.recall_precision(stills, tusimple.least_score())
            lines.append(f"| {curve}s | {name} | {recall:.1%} | {precision:.1%} |")
    return lines


def draw(folder: Path) -> None:
    """One still before and after: phantom.png."""
    labels = tusimple.data_file()
    if labels is None:
        return
    camera = tusimple.CAMERA
    image = cv2.imread(str(label_picture(read_labels(labels)[DRAWN], labels)))
    assert image is not None
    still = np.asarray(image, dtype=np.uint8)
    label_m = tusimple.look_at(labels, slice(DRAWN, DRAWN + 1))[0].label_m
    halves = []
    for name, given in _WAYS:
        settings = resolve_parameters(FINDING, given, 1)
        view = view_for(camera, settings)
        free = free_road(view, from_above(view, still), settings)
        halves.append(_drawn(still, camera, view, find_lines(view, still, settings), label_m, free))
        caption = name + (": no line is drawn where the road is hidden (blue)" if not given else "")
        cv2.putText(halves[-1], caption, (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.9, (255,) * 3, 2)
    legend = "green: within 0.35 m of a label 10 m ahead; red: no label there"
    cv2.putText(halves[0], legend, (20, 75), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (255,) * 3, 2)
    gap = np.full((still.shape[0], 8, 3), 255, dtype=np.uint8)
    cv2.imwrite(str(folder / "phantom.png"), np.hstack([halves[0], gap, halves[1]]))


def _drawn(
    image: Image,
    camera: Camera,
    view: BirdsEye,
    found: Found,
    label_m: np.ndarray,
    free: np.ndarray,
) -> Image:
    """The picture with what vehicles hide and with the lines, where the view shows free road."""
    image = image.copy()
    row, column = np.nonzero(~free & view.valid)
    u, v = road_to_image(camera, view.x_m[row], view.y_m[column])
    hidden = np.zeros(image.shape[:2], dtype=np.uint8)
    hidden[np.rint(v).astype(int), np.rint(u).astype(int)] = 1
    hidden = cv2.morphologyEx(hidden, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8)) > 0
    image[hidden] = image[hidden] // 2 + np.array(_HIDDEN, dtype=np.uint8) // 2
    still = tusimple.Still(label_m, found.shape @ tusimple.AHEAD, found.score)
    _, is_right = still.matched()
    x = view.x_m
    for shape, right in zip(found.shape, is_right, strict=True):
        y = shape[0] + x * (shape[1] + x * (shape[2] / 2 + x * shape[3] / 6))
        at = np.rint((y - view.y_m[0]) / view.across_m).astype(int)
        inside = (at >= 0) & (at < len(view.y_m))
        shown = inside & (view.valid & free)[np.arange(len(x)), np.where(inside, at, 0)]
        ends = np.stack(road_to_image(camera, x, y), axis=1)
        for k in np.flatnonzero(shown[1:] & shown[:-1]):
            a, b = np.rint(ends[k]).astype(int).tolist(), np.rint(ends[k + 1]).astype(int).tolist()
            cv2.line(image, a, b, _RIGHT if right else _WRONG, 4, cv2.LINE_AA)
    return image
