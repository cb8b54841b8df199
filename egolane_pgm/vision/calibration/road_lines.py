"""Finds painted lines in stills of a road, to calibrate a camera without labelled lines.

First it finds the point where most straight edges of all stills meet, by a vote of random pairs of
edges. Then each still is resampled along a fan of rays through that point, in which parallel lines
stand upright. The fan is turned and bent until bright, narrow streaks stand as upright as possible;
these streaks are the lines.

Points are rays a, b of the camera without lens distortion and roll, as in `straight_road`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.types import BoolArray, FloatArray, InputError
from egolane_pgm.vision.calibration.straight_road import (
    NEAREST_TO_HORIZON,
    FrameFit,
    RoadView,
    fit_frame,
    from_level,
    from_level_to_image,
    to_level,
    view_from,
)
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import read_image, read_images, size_of

#: The fan: the largest offset to either side and the step, in heights of the camera; and its rows.
_SIDE, _STEP = 5.0, 0.025
_ROWS = 120

#: The widest marking, in heights of the camera (block markings are 0.6 m wide and more).
_MARKING = 0.8

#: The widest dark seam, and the widest gap of a double line, in heights of the camera.
_SEAM = 0.15

#: A pixel is paint if it is brighter than its surroundings by more than the first number of grey
#: levels, and by more than the second number times the mean difference in its row.
_CONTRAST, _SCATTERS = 12.0, 4.0

#: The smallest share of a line's length in the picture that paint covers.
_COVERED = 0.08

#: A streak whose middle deviates by more than this (median, in heights of the camera) is grass or a
#: car, not paint.
_RAGGED = 0.06

#: The turns (a) and bends (c) of the fan that are tried for each still.
_TURNS = np.linspace(-0.025, 0.025, 11)
_BENDS = np.linspace(-0.0015, 0.0015, 7)

#: The largest difference in heading and pitch between stills of one drive (a, b).
_STILLS_DIFFER = np.array([0.1, 0.03])

#: An edge votes for a point if the sine of the angle between them is below the first value. Edges
#: shorter than the second (share of the picture's width) or flatter than the third (b per a) do not
#: vote, since they are no lines of the road ahead.
_NEAR, _SHORTEST, _FLATTEST = 0.02, 0.025, 0.12

#: The share of the length of all edges that must vote for the point where they meet. With edges in
#: random directions it is about a twentieth.
_AGREE = 0.08


#: How many random pairs of edges are tried over all stills.
_PAIRS = 3000


@dataclass(frozen=True)
class Fan:
    """A still, resampled along rays through the point where lines meet.

    - paint: (R, S) how much brighter a pixel is than both sides of it, grey levels
    - seen: (R, S) whether it is in the picture and not masked
    - below: (R,) b - b0 of each row
    - side: (S,) offset of each column, in heights of the camera
    """

    paint: FloatArray
    seen: BoolArray
    below: FloatArray
    side: FloatArray


def seen_mask(camera: Camera) -> BoolArray:
    """The pixels, (H, W), that may show road: all outside the camera's `ignore` rectangles."""
    mask = np.ones((camera.height, camera.width), dtype=bool)
    for left, top, right, bottom in camera.ignore:
        mask[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = False
    return mask


def edges(camera: Camera, image: Image, mask: BoolArray) -> FloatArray:
    """The straight edges of a picture, (M, 4): a, b of the upper end, then a, b of the lower end.

    mask: (H, W) pixels that may show road.
    """
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0)
    found = cv2.createLineSegmentDetector().detect(grey)[0]
    if found is None:
        return np.zeros((0, 4))
    found = found.reshape(-1, 4).astype(np.float64)
    middle = np.rint((found[:, :2] + found[:, 2:]) / 2).astype(int)
    rows = np.clip(middle[:, 1], 0, mask.shape[0] - 1)
    columns = np.clip(middle[:, 0], 0, mask.shape[1] - 1)
    found = found[mask[rows, columns]]
    ends = to_level(camera, found[:, [0, 2]], found[:, [1, 3]])
    order = np.argsort(ends[..., 1], axis=1)
    ends = np.take_along_axis(ends, order[..., None], axis=1)
    along = ends[:, 1] - ends[:, 0]
    is_long = np.hypot(along[:, 0], along[:, 1]) > _SHORTEST * camera.width / camera.fx
    keep = is_long & (along[:, 1] > _FLATTEST * np.abs(along[:, 0]))
    return ends[keep].reshape(-1, 4)


def _length(lines: FloatArray) -> FloatArray:
    """The lengths (M,) of edges (M, 4)."""
    return np.asarray(np.hypot(lines[:, 2] - lines[:, 0], lines[:, 3] - lines[:, 1]))


def _votes(points: FloatArray, lines: FloatArray) -> FloatArray:
    """The total length (P,) of the edges (M, 4) that point at each of the points (P, 2) from
    below."""
    upper, along, length = lines[:, :2], lines[:, 2:] - lines[:, :2], _length(lines)
    to = points[:, None, :] - (lines[:, :2] + lines[:, 2:])[None] / 2
    reach = np.hypot(to[..., 0], to[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = np.abs(to[..., 0] * along[:, 1] - to[..., 1] * along[:, 0]) / (reach * length)
    good = (sine < _NEAR) & (upper[None, :, 1] > points[:, None, 1])
    return np.asarray(np.where(good, length * (1 - sine / _NEAR), 0.0).sum(axis=1))


def _crossings(lines: FloatArray, tries: int, rng: np.random.Generator) -> FloatArray:
    """The points (P, 2) where random pairs of edges (M, 4) meet; long edges come more often."""
    weight = _length(lines)
    first, second = rng.choice(len(lines), (2, tries), p=weight / weight.sum())
    p, r = lines[first, :2], lines[first, 2:] - lines[first, :2]
    q, s = lines[second, :2], lines[second, 2:] - lines[second, :2]
    cross = r[:, 0] * s[:, 1] - r[:, 1] * s[:, 0]
    far = np.abs(cross) > 0.1 * np.hypot(*r.T) * np.hypot(*s.T)
    p, r, q, s, cross = p[far], r[far], q[far], s[far], cross[far]
    along = ((q - p)[:, 0] * s[:, 1] - (q - p)[:, 1] * s[:, 0]) / cross
    return np.asarray(p + along[:, None] * r)


def _winner(candidates: FloatArray, votes: FloatArray) -> FloatArray:
    best: FloatArray = candidates[np.argmax(votes)]
    for _ in range(3):
        near = np.hypot(*(candidates - best).T) < 0.03
        best = np.average(candidates[near], axis=0, weights=votes[near] ** 2 + 1e-12)
    return best


def meeting_of_stills(stills: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """The point (2,) where most edges of all stills meet, and the points (F, 2) near it where the
    edges of each still meet (NaN where they do not).

    stills: the edges (M, 4) of each of the F stills.

    Raises InputError if the edges do not meet in one point.
    """
    rng = np.random.default_rng(0)
    n = max(60, _PAIRS // max(len(stills), 1))
    crossings = [
        _crossings(lines, n, rng) if len(lines) >= 2 else np.zeros((0, 2)) for lines in stills
    ]
    candidates = np.concatenate(crossings)
    if not len(candidates):
        raise InputError("stills: no straight edges that meet; are they of a road ahead?")
    votes = np.sum([_votes(candidates, lines) for lines in stills], axis=0)
    if votes.max() < _AGREE * np.concatenate([_length(lines) for lines in stills]).sum():
        raise InputError(
            "stills: their straight edges do not meet in one point; choose stills of a straight"
            " road, and leave out bonnet and mirror (ignore)"
        )
    every = _winner(candidates, votes)
    each = np.full((len(stills), 2), np.nan)
    for i, (points, lines) in enumerate(zip(crossings, stills, strict=True)):
        near = points[(np.abs(points - every) < _STILLS_DIFFER).all(axis=1)]
        votes = _votes(near, lines)
        if votes.any():
            each[i] = _winner(near, votes)
    return every, each


def fan(
    camera: Camera, grey: FloatArray, mask: BoolArray, point: FloatArray, bend: float = 0.0
) -> Fan:
    """Resamples a picture along rays through a point, so that paint along the road stands upright.

    - grey: (H, W) brightness, grey levels
    - mask: (H, W) pixels that may show road
    - point: (2,) the point a, b where lines meet
    - bend: c, half the road's curvature times the camera's height
    """
    lowest = to_level(camera, np.array([camera.width / 2]), np.array([camera.height - 1.0]))[0, 1]
    # The rows are denser far away, where dashes are shorter in the picture.
    farthest, nearest = NEAREST_TO_HORIZON, max(lowest - point[1], 2 * NEAREST_TO_HORIZON)
    below = np.geomspace(farthest, nearest, _ROWS)
    side = np.arange(-_SIDE, _SIDE + _STEP / 2, _STEP)
    rays = _rays(point, bend, side[None, :], below[:, None])
    u, v = from_level_to_image(camera, rays)
    # Far outside the picture the distortion formula folds points back into it.
    free_u, free_v = from_level(camera, rays)
    inside = (np.abs(free_u - camera.cx) < 0.75 * camera.width) & (free_v < 1.25 * camera.height)
    u, v = u.astype(np.float32), v.astype(np.float32)
    bright = cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen = cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST, borderValue=0)
    kernel = np.ones((1, round(_MARKING / _STEP) | 1), dtype=np.uint8)
    # The road between two dark seams is no paint, nor is the gap of a double line a gap.
    seam = np.ones((1, round(_SEAM / _STEP) | 1), dtype=np.uint8)
    bright = cv2.morphologyEx(bright, cv2.MORPH_CLOSE, seam)
    paint = cv2.morphologyEx(bright, cv2.MORPH_TOPHAT, kernel)
    shown = cv2.erode(seen, kernel) * inside > 0
    return Fan(np.where(shown, paint, 0.0), shown, below, side)


def _rays(point: FloatArray, bend: float, side: FloatArray, below: FloatArray) -> FloatArray:
    side, below = np.broadcast_arrays(side, below)
    return np.stack([point[0] + side * below + bend / below, point[1] + below], axis=-1)


def is_paint(found: Fan) -> BoolArray:
    """Which pixels of a fan, (R, S), are paint."""
    n_seen = np.maximum(found.seen.sum(axis=1, keepdims=True), 1)
    scatter = found.paint.sum(axis=1, keepdims=True) / n_seen
    is_bright: BoolArray = found.paint > np.maximum(_CONTRAST, _SCATTERS * scatter)
    return is_bright & found.seen


def _profile(found: Fan) -> FloatArray:
    """The share of each ray that is paint, (S,); 0 where too little of the ray is seen."""
    n_seen = found.seen.sum(axis=0)
    share = is_paint(found).sum(axis=0) / np.maximum(n_seen, 1)
    return np.where(n_seen > 0.25 * len(found.below), share, 0.0)


def grey_of(image: Image) -> FloatArray:
    """The mean of green and red, (H, W), float32, in which white and yellow paint are bright."""
    return np.asarray(image[..., 1:].mean(axis=-1, dtype=np.float32))


def find_lines(
    camera: Camera, image: Image, mask: BoolArray, about: FloatArray
) -> list[FloatArray]:
    """The points (N, 2), pixels, of each line painted on the road in a still.

    - mask: (H, W) pixels that may show road
    - about: (2,) the point a, b where the lines roughly meet
    """
    grey = grey_of(image)
    best, point, bend = -1.0, about, 0.0
    for c in _BENDS:
        for da in _TURNS:
            at = about + np.array([da, 0.0])
            profile = _profile(fan(camera, grey, mask, at, c))
            sharp = float(np.sum(profile**2)) * (1 - 0.05 * abs(c) / _BENDS[-1])
            if sharp > best:
                best, point, bend = sharp, at, c
    found = fan(camera, grey, mask, point, bend)
    lines = []
    for side, below in _streaks(found):
        pixels = from_level_to_image(camera, _rays(point, bend, side, below))
        lines.append(np.stack(pixels, axis=-1))
    return lines


def _streaks(found: Fan) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Upright streaks of paint in a fan, the most covered one first: `side` and `below`, (N,)
    each, of the rows with paint."""
    paint, profile = is_paint(found), _profile(found)
    smooth = np.convolve(profile, np.ones(3) / 3, mode="same")
    taken = np.zeros(len(smooth), dtype=bool)
    reach = round(0.5 * _MARKING / _STEP)
    for peak in np.argsort(-smooth):
        if smooth[peak] < _COVERED:
            break
        if taken[peak]:
            continue
        window = slice(max(0, peak - reach), peak + reach + 1)
        taken[max(0, peak - 2 * reach) : peak + 2 * reach + 1] = True
        weight = found.paint[:, window] * paint[:, window]
        rows = weight.sum(axis=1) > 0
        side = (weight[rows] @ found.side[window]) / weight[rows].sum(axis=1)
        if rows.sum() >= 5 and np.median(np.abs(side - np.median(side))) < _RAGGED:
            yield side, found.below[rows]


@dataclass(frozen=True)
class FoundLines:
    """The lines found in the stills of a drive.

    - ahead: (2,) the point a, b where the edges of all stills meet
    - each: (F, 2) the same for single stills, where it was found
    - paths: the stills that were used
    - lines: for each of these, the points (N, 2) of its lines, pixels
    - fits: the fits of the stills with at least two lines
    - skipped: one line for each still that was not used, with the reason
    """

    ahead: FloatArray
    each: FloatArray
    paths: tuple[Path, ...]
    lines: tuple[list[FloatArray], ...]
    fits: tuple[FrameFit, ...]
    skipped: tuple[str, ...]


def find_in_stills(
    camera: Camera,
    paths: Iterable[Path],
    progress: Callable[[Iterable[Path]], Iterable[Path]] = iter,
) -> FoundLines:
    """Finds the lines in stills that one camera took of a road.

    - paths: the stills; `camera.ignore` says which parts never show road
    - progress: wraps the stills while they are read, e.g. tqdm

    Raises InputError if no still can be used, or if the edges do not meet in one point.
    """
    mask = seen_mask(camera)
    skipped: list[str] = []
    used, straight = [], []
    for path, image in read_images(progress(paths), skipped):
        width, height = size_of(image)
        if (width, height) != (camera.width, camera.height):
            skipped.append(f"{path}: {width}x{height}, needs {camera.width}x{camera.height}")
            continue
        used.append(path)
        straight.append(edges(camera, image, mask))
    if not used:
        raise InputError(f"stills: none of them can be used; {skipped[0]}")
    ahead, each = meeting_of_stills(straight)
    fits, lines = [], []
    for path, point in zip(progress(used), each, strict=True):
        about = point if np.isfinite(point).all() else ahead
        found = find_lines(camera, read_image(path), mask, about)
        lines.append(found)
        rays = [to_level(camera, line[:, 0], line[:, 1]) for line in found]
        fit = fit_frame(rays, float(ahead[1]))
        if fit and (np.abs(fit.vanishing_point - ahead) < _STILLS_DIFFER).all():
            fits.append(fit)
    each = each[np.isfinite(each).all(axis=1)]
    return FoundLines(ahead, each, tuple(used), tuple(lines), tuple(fits), tuple(skipped))


def view_from_stills(camera: Camera, found: FoundLines, lane_width_m: float) -> RoadView:
    """Finds how a camera looks at the road, from the lines that `find_in_stills` found with it.
    Raises InputError as `view_from` does."""
    return view_from(camera, found.ahead, found.each, found.fits, lane_width_m, "stills")
