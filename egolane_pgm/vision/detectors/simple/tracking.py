"""Follows the lines found in single frames over time (paper, section
`section:simple-line-detector`): a Kalman filter updates each line's parameters, and its LRI counts
detections.

A line is y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6. The measurement is where it lies at some
distances ahead, because there it was seen; its offset at the car is an extrapolation. The car's own
motion moves all lines alike, so one shift per frame is estimated for all of them together. On a
clothoid the curvature grows by its rate times the distance driven. That distance is not known here,
so this growth is part of the same shift, and the rate is predicted to stay. This module works on
arrays alone and sees no picture.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.detectors import FrameLines, powers
from egolane_pgm.vision.detectors.simple.parameters import CURVES

#: The distances ahead at which a line is compared (four parameters need four), and the standard
#: deviations of a found line there, metres; that of the rate of a clothoid's curvature, 1/m^2.
_PLACES = 4
_AHEAD_M = np.linspace(6.0, 30.0, _PLACES)
_SIGMA_M, _SIGMA_RATE = np.linspace(0.12, 0.35, _PLACES), 2e-5

#: Standard deviations of a line's own change per frame: heading (radians), curvature (1/m), rate.
_WALK = (0.004, 2e-4, 4e-6)

#: The share of the matched lines' common change of curvature that counts as common motion (the
#: road's).
_CURVATURE_GAIN = 0.3

#: Standard deviation of a line's own change of offset per frame, metres.
_OFFSET_WALK_M = 0.06

#: The shares of the matched lines' common motion that move every line (the car's motion), and that
#: enter the steady motion, with which lines are predicted.
_SHIFT_GAIN, _MOTION_GAIN = 0.6, 0.4

#: The share of frames that a line must be detected in to become valid: a detection counts one, a
#: miss takes away share / (1 - share), though never more than there is, and k are needed (Page's
#: test of 1954 for a rate above this one). A valid line stays so until its LRI is below the second
#: share of k.
_VALID_SHARE, _VALID_UNTIL = 0.55, 0.5

#: The frames in a row without detection after which a line is dropped that was valid once, and one
#: that never was.
_DIE_AFTER, _NEW_DIE_AFTER = 10, 3

#: The largest distance of a line from its prediction: metres, and standard deviations on average.
_GATE_M, _GATE_SIGMAS = 1.0, 4.0

#: Of two lines nearer to each other than the first, metres, one is dropped. A line beyond another,
#: seen from the car, and nearer to it than the second bounds no lane (the foot of a barrier, a
#: kerb). Lines farther to the side than the third are dropped.
_APART_M, _LEAST_LANE_M, _FARTHEST_M = 1.0, 2.8, 14.0

#: How many of a line's last detections vote on continuous or dashed, and the share of the votes
#: that makes it continuous.
_VOTE_FRAMES, _CONTINUOUS_SHARE = 20, 0.5

#: Limit on a new line's standard deviations, in steps of the walk.
_OPEN_STEPS = 50


@dataclass(frozen=True)
class Tracks:
    """The L lines that are followed, in no particular order.

    - number: (L,) identifies a line for as long as it is followed
    - mean, covariance: (L, 4) and (L, 4, 4), of the line's parameters
    - hits: (L, k) how probable its detection was in the last k frames, the newest last; 0 for none,
      1 for one of which nobody says how probable it is
    - excess: (L,) how many detections it has beyond the share that makes it valid, 0 to k
    - votes: (L, v) of its last v detections: 1 for continuous, 0 for dashed, NaN for no vote
    - missed: (L,) frames since it was last detected
    - is_valid, was_valid: (L,) whether it is valid, and whether it ever was
    - motion: (4,) change of the parameters per frame that all lines share
    - n_started: how many lines have been started so far
    """

    number: IntArray
    mean: FloatArray
    covariance: FloatArray
    hits: FloatArray
    excess: FloatArray
    votes: FloatArray
    missed: IntArray
    is_valid: BoolArray
    was_valid: BoolArray
    motion: FloatArray
    n_started: int = 0

    def __len__(self) -> int:
        return len(self.number)

    @property
    def lri(self) -> FloatArray:
        """The expected number of true detections in the last k frames, (L,)."""
        return np.asarray(self.hits.sum(axis=1))


@dataclass(frozen=True)
class Rules:
    """The parameters of tracking and the matrices that follow from them.

    - lri_frames: k
    - continuous_cover: the painted share of a line from which on a frame votes for continuous
    - beyond_edge: which lines beyond the edge of the road are hidden
    - gate_m: largest distance of a line from its prediction
    - n_values: how many of a shape's four values the lines have: 2 if they are straight
    - at: (J, 4) takes a line's parameters to its places at J distances ahead
    - noise: (J, J) covariance of a measurement
    - miss_cost: how many detections make up for a miss before a line is valid
    - walk: (4, 4) covariance of the change from frame to frame
    - first: (4, 4) covariance of a line that was detected once
    - to_shift: (2, J) takes places to the offset and heading that fit them best
    - to_curvature: (J,) takes places to the curvature of the parabola that fits them best
    """

    lri_frames: int
    continuous_cover: float
    beyond_edge: str
    gate_m: float
    n_values: int
    at: FloatArray
    noise: FloatArray
    miss_cost: float
    walk: FloatArray
    first: FloatArray
    to_shift: FloatArray
    to_curvature: FloatArray


def rules(parameters: Parameters, *, curve: str, gate_m: float = _GATE_M) -> Rules:
    """The rules of tracking, from checked values of the parameters.

    - curve: "line", "parabola" or "clothoid"
    - gate_m: largest distance of a line from its prediction
    """
    n_values = CURVES[curve]
    at = powers(_AHEAD_M)
    noise = np.diag(_SIGMA_M**2)
    if n_values == 4:
        noise = _noise_of_clothoids(at, _SIGMA_M, _SIGMA_RATE)
    walk = np.array([_OFFSET_WALK_M, *_WALK])
    walk[n_values:] = 0.0
    inverse = np.linalg.pinv(at)
    first = inverse @ noise @ inverse.T
    narrower = np.minimum(1.0, _OPEN_STEPS * walk / np.sqrt(np.diag(first)))
    first *= narrower[:, None] * narrower
    is_strict = parameters["valid_when"] == "paper"
    miss_cost = np.inf if is_strict else _VALID_SHARE / (1 - _VALID_SHARE)
    weight = 1 / np.sqrt(np.diag(noise))
    design = at * weight[:, None]
    to_shift: FloatArray = np.linalg.pinv(design[:, :2]) * weight
    to_curvature: FloatArray = np.linalg.pinv(design[:, :3])[2] * weight
    return Rules(
        int(number(parameters, "lri_frames")),
        number(parameters, "continuous_cover"),
        str(parameters["beyond_edge"]),
        gate_m,
        n_values,
        at,
        noise,
        miss_cost,
        np.diag(walk**2),
        first,
        to_shift,
        to_curvature,
    )


def _noise_of_clothoids(at: FloatArray, sigma: FloatArray, sigma_rate: float) -> FloatArray:
    """The covariance (J, J) of a clothoid's places: that of the parabola through places with
    independent errors (J,), and that of the rate, which the fit to all contours tells far better
    than four such places would."""
    parabola = at[:, :3]
    covariance = np.linalg.inv((parabola / sigma[:, None] ** 2).T @ parabola)
    # What a parabola cannot follow of a unit of rate.
    rest = at[:, 3] - parabola @ covariance @ (parabola.T @ (at[:, 3] / sigma**2))
    noise: FloatArray = parabola @ covariance @ parabola.T
    return noise + sigma_rate**2 * np.outer(rest, rest)


def no_tracks(rule: Rules) -> Tracks:
    """The tracks before the first frame: none."""
    return Tracks(
        number=np.zeros(0, dtype=np.int64),
        mean=np.zeros((0, 4)),
        covariance=np.zeros((0, 4, 4)),
        hits=np.zeros((0, rule.lri_frames)),
        excess=np.zeros(0),
        votes=np.zeros((0, _VOTE_FRAMES)),
        missed=np.zeros(0, dtype=np.int64),
        is_valid=np.zeros(0, dtype=bool),
        was_valid=np.zeros(0, dtype=bool),
        motion=np.zeros(4),
    )


def expected(tracks: Tracks) -> FloatArray:
    """The lines (K, 4) predicted for the next frame, left to right: the valid ones, or all of them
    if none is valid."""
    shapes = tracks.mean[tracks.is_valid | ~tracks.is_valid.any()] + tracks.motion
    return shapes[np.argsort(shapes[:, 0], kind="stable")]


def advance(
    tracks: Tracks,
    rule: Rules,
    shape: FloatArray,
    coverage: FloatArray,
    likely: FloatArray | None = None,
) -> Tracks:
    """The tracks after one more frame.

    - shape: (M, 4) the lines found in it
    - coverage: (M,) the share of each line that is painted; NaN where that is unknown
    - likely: (M,) how probable each line is; 1 where it is left out
    """
    likely = np.ones(len(shape)) if likely is None else likely
    shape = np.where(np.arange(4) < rule.n_values, shape, 0.0)
    tracks = predicted(tracks, rule)
    matched = _match(tracks, rule, shape)
    tracks = _update(tracks, rule, matched, shape, coverage, likely)
    is_new = np.ones(len(shape), dtype=bool)
    is_new[matched[matched >= 0]] = False
    for found in np.flatnonzero(is_new):
        new = _new_track(tracks, rule, shape[found], coverage[found], likely[found])
        is_apart = _gaps(tracks.mean, shape[found], rule) >= _APART_M
        if is_apart.all() and not _are_just_beyond(tracks, new, rule)[0]:
            tracks = _joined(tracks, new)
    return _without_lost(_with_validity(tracks, rule), rule)


def predicted(tracks: Tracks, rule: Rules) -> Tracks:
    """The tracks one frame later, in which nobody looked for lines."""
    return replace(
        tracks, mean=tracks.mean + tracks.motion, covariance=tracks.covariance + rule.walk
    )


def lines_of(tracks: Tracks, rule: Rules) -> FrameLines:
    """The lines of a frame, left to right, as the detector gives them."""
    is_continuous = continuous_share(tracks) > _CONTINUOUS_SHARE
    order = np.argsort(tracks.mean[:, 0], kind="stable")
    order = order[~_is_hidden(tracks, is_continuous, rule)[order]]
    return FrameLines(
        tracks.mean[order],
        tracks.is_valid[order],
        is_continuous[order],
        tracks.lri[order],
    )


def _is_hidden(tracks: Tracks, is_continuous: BoolArray, rule: Rules) -> BoolArray:
    """Which lines, (L,), the parameter `beyond_edge` hides."""
    choice, offset = rule.beyond_edge, tracks.mean[:, 0]
    edges = offset[is_continuous & tracks.is_valid]
    left, right = edges[edges < 0].max(initial=-np.inf), edges[edges > 0].min(initial=np.inf)
    is_beyond: BoolArray = (offset < left) | (offset > right)
    if choice == "keep":
        return np.zeros_like(is_beyond)
    return is_beyond if choice == "hide_all" else is_beyond & is_continuous


def continuous_share(tracks: Tracks) -> FloatArray:
    """The share of each line's votes that says continuous, (L,); 0 without a vote."""
    n_votes = np.isfinite(tracks.votes).sum(axis=1)
    return np.asarray(np.nansum(tracks.votes, axis=1) / np.maximum(n_votes, 1))


def _match(tracks: Tracks, rule: Rules, shape: FloatArray) -> IntArray:
    """For each line, (L,), the index of the found line that continues it, or -1. The closest pairs
    are matched first."""
    taken = np.full(len(tracks), -1, dtype=np.int64)
    if not len(tracks) or not len(shape):
        return taken
    gap = (shape[None, :, :] - tracks.mean[:, None, :]) @ rule.at.T
    spread = rule.at @ tracks.covariance @ rule.at.T + rule.noise
    variance = np.diagonal(spread, axis1=1, axis2=2)[:, None, :]
    sigmas = np.sqrt((gap**2 / variance).mean(axis=2))
    # The gate in metres uses the nearer half, because far ahead a small turn makes a large gap.
    metres = np.abs(gap[..., : _PLACES // 2]).mean(axis=2)
    cost = np.where((metres <= rule.gate_m) & (sigmas <= _GATE_SIGMAS), metres, np.inf)
    while np.isfinite(cost).any():
        line, found = np.unravel_index(int(np.argmin(cost)), cost.shape)
        taken[line] = found
        cost[line, :] = np.inf
        cost[:, found] = np.inf
    return taken


def _update(
    tracks: Tracks,
    rule: Rules,
    matched: IntArray,
    shape: FloatArray,
    coverage: FloatArray,
    likely: FloatArray,
) -> Tracks:
    """Updates the matched lines by a Kalman step, and counts the hits and votes of all lines."""
    is_hit = matched >= 0
    found = matched[is_hit]
    # One line of several may have moved alone, which says nothing about the car.
    shows_motion = len(found) >= min(2, len(tracks))
    moved = (shape[found] - tracks.mean[is_hit]) @ rule.at.T
    shift = _common_shift(moved, rule) if shows_motion and len(found) else np.zeros(4)
    tracks = replace(tracks, mean=tracks.mean + _SHIFT_GAIN * shift)
    mean, covariance, votes = tracks.mean.copy(), tracks.covariance.copy(), tracks.votes.copy()
    prior = covariance[is_hit]
    spread = rule.at @ prior @ rule.at.T + rule.noise
    gain = np.linalg.solve(spread, rule.at @ prior).transpose(0, 2, 1)
    surprise = (shape[found] - mean[is_hit]) @ rule.at.T
    mean[is_hit] += np.einsum("lij,lj->li", gain, surprise)
    # Joseph's form stays symmetric and positive definite.
    kept = np.eye(4) - gain @ rule.at
    covariance[is_hit] = kept @ prior @ kept.transpose(0, 2, 1) + gain @ rule.noise @ (
        gain.transpose(0, 2, 1)
    )
    is_known = np.isfinite(coverage[found])
    voting = np.flatnonzero(is_hit)[is_known]
    hit = np.zeros(len(tracks))
    hit[is_hit] = likely[found]
    vote = coverage[found][is_known] >= rule.continuous_cover
    votes[voting] = np.concatenate([votes[voting][:, 1:], vote[:, None]], axis=1)
    return replace(
        tracks,
        mean=mean,
        covariance=covariance,
        votes=votes,
        hits=np.column_stack([tracks.hits[:, 1:], hit]),
        excess=np.clip(
            tracks.excess + np.where(is_hit, 1.0, -rule.miss_cost), 0.0, tracks.hits.shape[1]
        ),
        missed=np.where(is_hit, 0, tracks.missed + 1),
        # Without matched lines the common motion decays.
        motion=(
            tracks.motion + _MOTION_GAIN * shift
            if shows_motion
            else tracks.motion * (1 - _MOTION_GAIN)
        ),
    )


def _common_shift(moved: FloatArray, rule: Rules) -> FloatArray:
    """The change of offset and heading, and of curvature where lines have one, as (4,), that most
    of the K matched lines show.

    moved: (K, J) measured minus predicted places, metres.
    """
    shift = np.zeros(4)
    middle = np.median(moved, axis=0)
    if rule.n_values > 2:
        shift[2] = _CURVATURE_GAIN * (rule.to_curvature @ middle)
        middle = middle - rule.at[:, 2] * shift[2]
    shift[:2] = rule.to_shift @ middle
    return shift


def _new_track(
    tracks: Tracks, rule: Rules, shape: FloatArray, coverage: float, likely: float
) -> Tracks:
    """Tracks with a single line, which was detected for the first time."""
    hits = np.zeros((1, tracks.hits.shape[1]))
    hits[0, -1] = likely
    votes = np.full((1, tracks.votes.shape[1]), np.nan)
    if np.isfinite(coverage):
        votes[0, -1] = coverage >= rule.continuous_cover
    return Tracks(
        number=np.array([tracks.n_started + 1]),
        mean=shape[None].astype(np.float64),
        covariance=rule.first[None],
        hits=hits,
        excess=np.ones(1),
        votes=votes,
        missed=np.zeros(1, dtype=np.int64),
        is_valid=np.zeros(1, dtype=bool),
        was_valid=np.zeros(1, dtype=bool),
        motion=tracks.motion,
        n_started=tracks.n_started + 1,
    )


def _with_validity(tracks: Tracks, rule: Rules) -> Tracks:
    """Sets `is_valid`: a line becomes valid with k detections in excess, which without a miss is
    the largest LRI (the paper's rule), and stays so until its LRI falls below a share of k."""
    k, seen = tracks.hits.shape[1], (tracks.hits > 0).sum(axis=1)
    is_valid = (tracks.excess >= k) | (tracks.is_valid & (seen >= _VALID_UNTIL * k))
    return replace(tracks, is_valid=is_valid, was_valid=tracks.was_valid | is_valid)


def _without_lost(tracks: Tracks, rule: Rules) -> Tracks:
    """Drops lines that were missed for too long, are too far to the side, or are too close to a
    better one."""
    patience = np.where(tracks.was_valid, _DIE_AFTER, _NEW_DIE_AFTER)
    is_good = (tracks.missed < patience) & (np.abs(tracks.mean[:, 0]) <= _FARTHEST_M)
    tracks = _chosen(tracks, np.flatnonzero(is_good))
    is_close = _gaps(tracks.mean[:, None], tracks.mean, rule) < _APART_M
    is_beyond = _are_just_beyond(tracks, tracks, rule)
    kept: list[int] = []
    for k in np.lexsort((tracks.number, -tracks.lri, ~tracks.is_valid)):
        if not is_beyond[k] and not is_close[k, kept].any():
            kept.append(int(k))
    return _chosen(tracks, np.sort(np.array(kept, dtype=np.int64)))


def _are_just_beyond(tracks: Tracks, some: Tracks, rule: Rules) -> BoolArray:
    """Which of N lines, (N,), lie beyond one of the tracks, seen from the car, too close for a lane
    between them. That one is valid, or is detected in this frame and has at least the same LRI."""
    near = rule.at[: _PLACES // 2].mean(axis=0)
    place, places = (some.mean @ near)[:, None], tracks.mean @ near
    is_between = (np.sign(places) == np.sign(place)) & (np.abs(places) < np.abs(place))
    is_between &= tracks.number != some.number[:, None]
    is_close = _gaps(some.mean[:, None], tracks.mean, rule) < _LEAST_LANE_M
    is_good = tracks.is_valid | ((tracks.lri >= some.lri[:, None]) & (tracks.missed == 0))
    return np.asarray((is_between & is_close & is_good).any(axis=1))


def _gaps(means: FloatArray, others: FloatArray, rule: Rules) -> FloatArray:
    """The distance (...), metres, of lines (..., 4) from others (..., 4), over the nearer half of
    the distances ahead."""
    return np.asarray(np.abs((means - others) @ rule.at[: _PLACES // 2].T).mean(axis=-1))


def _per_line(tracks: Tracks) -> dict[str, Any]:
    shared = ("motion", "n_started")
    return {f.name: getattr(tracks, f.name) for f in fields(tracks) if f.name not in shared}


def _chosen(tracks: Tracks, which: IntArray) -> Tracks:
    if len(which) == len(tracks):
        return tracks
    few = {name: a[which] for name, a in _per_line(tracks).items()}
    return replace(tracks, **few)


def _joined(tracks: Tracks, more: Tracks) -> Tracks:
    two = _per_line(more)
    both: dict[str, Any] = {
        name: np.concatenate([a, two[name]]) for name, a in _per_line(tracks).items()
    }
    return replace(more, **both)
