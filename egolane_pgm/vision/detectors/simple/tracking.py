"""Track the lines of single frames over time (paper, section `section:simple-line-detector`): a
Kalman filter updates each line's parameters, and its LRI counts detections.

A line is y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6. It is measured at some distances ahead, where
it was visible; its offset at the car is an extrapolation. The car's motion moves all lines alike,
so one shift per frame is estimated for all of them. It includes the growth of a clothoid's
curvature, its rate times the unknown distance driven; the rate is predicted to stay.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.detectors import FrameLines, powers
from egolane_pgm.vision.detectors.simple.parameters import CURVES

#: Number of distances ahead at which a line is compared: four parameters need four.
_PLACES = 4

#: These distances, metres.
_AHEAD_M = np.linspace(6.0, 30.0, _PLACES)

#: Standard deviations of a found line at these distances, metres.
_SIGMA_M = np.linspace(0.12, 0.35, _PLACES)

#: Standard deviation of the rate of a clothoid's curvature, 1/m^2.
_SIGMA_RATE = 2e-5

#: Standard deviations of a line's change per frame: offset (m), heading, curvature (1/m), rate.
_WALK = (0.06, 0.004, 2e-4, 4e-6)

#: Share of the matched lines' common motion that moves every line.
_SHIFT_GAIN = 0.6

#: Share of the common motion that enters the predicted motion.
_MOTION_GAIN = 0.4

#: Share of the common change of curvature that counts as common motion.
_CURVATURE_GAIN = 0.3

#: Share of frames that a line must be detected in to become valid: a detection counts one, a miss
#: takes away `_MISS_COST`, down to 0, and k are needed (Page's test of 1954 for a rate above this
#: one).
_VALID_SHARE = 0.55
_MISS_COST = _VALID_SHARE / (1 - _VALID_SHARE)

#: A valid line stays valid until its LRI is below this share of k.
_VALID_UNTIL = 0.5

#: Missed frames in a row after which a line that was ever valid is dropped.
_DIE_AFTER = 10

#: Missed frames in a row after which a line that was never valid is dropped.
_NEW_DIE_AFTER = 3

#: Largest distance of a line from its prediction, metres.
_GATE_M = 1.0

#: Largest distance of a line from its prediction, mean standard deviations.
_GATE_SIGMAS = 4.0

#: One of two lines nearer to each other than this, metres, is dropped.
_APART_M = 1.0

#: A line beyond another, as viewed from the car, and nearer to it than this, metres, bounds no lane
#: (the foot of a barrier, a kerb).
_LEAST_LANE_M = 2.8

#: Lines farther to the side are dropped, metres.
_FARTHEST_M = 14.0

#: Number of a line's last detections that vote on continuous or dashed.
_VOTE_FRAMES = 20

#: Share of the votes above which a line is continuous.
_CONTINUOUS_SHARE = 0.5

#: Limit on a new line's standard deviations, in steps of the walk.
_OPEN_STEPS = 50


@dataclass(frozen=True)
class Tracks:
    """The L tracked lines, in no particular order.

    - number: (L,) identifies a line for as long as it is tracked
    - mean, covariance: (L, 4) and (L, 4, 4), of the line's parameters
    - hits: (L, k) probability of its detection in each of the last k frames, the newest last; 0
      without detection
    - excess: (L,) detections beyond the share that makes it valid, 0 to k
    - votes: (L, v) of its last v detections: 1 for continuous, 0 for dashed, NaN for no vote
    - missed: (L,) frames since its last detection
    - is_valid, was_valid: (L,) validity in this frame, and in any frame so far
    - motion: (4,) common change of the parameters per frame
    - n_started: number of lines started so far
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
    - continuous_cover: least painted share of a line for a vote for continuous
    - hides_beyond: whether lines beyond the edge of the road are hidden
    - gate_m: largest distance of a line from its prediction
    - n_values: number of shape values that are not 0: 2 if lines are straight
    - at: (J, 4) maps a line's parameters to its lateral positions at J distances ahead
    - noise: (J, J) covariance of a measurement
    - walk: (4, 4) covariance of the change from frame to frame
    - first: (4, 4) covariance of a line that was detected once
    """

    lri_frames: int
    continuous_cover: float
    hides_beyond: bool
    gate_m: float
    n_values: int
    at: FloatArray
    noise: FloatArray
    walk: FloatArray
    first: FloatArray


def rules(parameters: Parameters, *, curve: str, gate_m: float = _GATE_M) -> Rules:
    """Make the rules of tracking.

    - curve: "line", "parabola" or "clothoid"
    - gate_m: largest distance of a line from its prediction
    """
    n_values = CURVES[curve]
    at = powers(_AHEAD_M)
    noise = np.diag(_SIGMA_M**2)
    if n_values == 4:
        noise = _noise_of_clothoids(at)
    walk = np.array(_WALK)
    walk[n_values:] = 0.0
    inverse = np.linalg.pinv(at)
    first = inverse @ noise @ inverse.T
    narrower = np.minimum(1.0, _OPEN_STEPS * walk / np.sqrt(np.diag(first)))
    first *= narrower[:, None] * narrower
    return Rules(
        lri_frames=int(number(parameters, "lri_frames")),
        continuous_cover=number(parameters, "continuous_cover"),
        hides_beyond=parameters["beyond_edge"] == "hide",
        gate_m=gate_m,
        n_values=n_values,
        at=at,
        noise=noise,
        walk=np.diag(walk**2),
        first=first,
    )


def _noise_of_clothoids(at: FloatArray) -> FloatArray:
    """Return the covariance (J, J) of a clothoid's positions: a parabola's positions have
    independent errors, and the rate is known far better, from the fit to all contours."""
    parabola = at[:, :3]
    precision = _SIGMA_M**-2
    covariance = np.linalg.inv((parabola * precision[:, None]).T @ parabola)
    # The part of a unit of rate that a parabola cannot follow.
    rest = at[:, 3] - parabola @ covariance @ (parabola.T @ (at[:, 3] * precision))
    noise: FloatArray = parabola @ covariance @ parabola.T
    return noise + _SIGMA_RATE**2 * np.outer(rest, rest)


def no_tracks(rule: Rules) -> Tracks:
    """Return the empty tracks before the first frame."""
    return _new_tracks(rule, np.zeros((0, 4)), np.zeros(0), np.zeros(0))


def _new_tracks(
    rule: Rules, shape: FloatArray, coverage: FloatArray, likely: FloatArray, n_started: int = 0
) -> Tracks:
    """Make tracks of N lines (N, 4) that were detected for the first time."""
    n_lines = len(shape)
    hits = np.zeros((n_lines, rule.lri_frames))
    hits[:, -1] = likely
    votes = np.full((n_lines, _VOTE_FRAMES), np.nan)
    votes[:, -1] = np.where(np.isnan(coverage), np.nan, coverage >= rule.continuous_cover)
    return Tracks(
        number=n_started + 1 + np.arange(n_lines),
        mean=shape,
        covariance=np.repeat(rule.first[None], n_lines, axis=0),
        hits=hits,
        excess=np.ones(n_lines),
        votes=votes,
        missed=np.zeros(n_lines, dtype=np.int64),
        is_valid=np.zeros(n_lines, dtype=bool),
        was_valid=np.zeros(n_lines, dtype=bool),
        motion=np.zeros(4),
        n_started=n_started + n_lines,
    )


def expected(tracks: Tracks) -> FloatArray:
    """Predict the lines (K, 4) of the next frame, left to right: the valid ones, or all of them if
    no line is valid."""
    shapes = tracks.mean[tracks.is_valid | ~tracks.is_valid.any()] + tracks.motion
    return shapes[np.argsort(shapes[:, 0], kind="stable")]


def advance(
    tracks: Tracks,
    rule: Rules,
    shape: FloatArray,
    coverage: FloatArray,
    likely: FloatArray | None = None,
) -> Tracks:
    """Update the tracks with the M lines found in the next frame.

    - shape: (M, 4) the lines
    - coverage: (M,) painted share of each line; NaN if unknown
    - likely: (M,) probability of each line; 1 by default
    """
    likely = np.ones(len(shape)) if likely is None else likely
    shape = np.where(np.arange(4) < rule.n_values, shape, 0.0)
    tracks = replace(
        tracks, mean=tracks.mean + tracks.motion, covariance=tracks.covariance + rule.walk
    )
    matched = _match(tracks, rule, shape)
    tracks = _update(tracks, rule, matched, shape, coverage, likely)
    for found in np.setdiff1d(np.arange(len(shape)), matched):
        one = slice(found, found + 1)
        new = _new_tracks(rule, shape[one], coverage[one], likely[one], tracks.n_started)
        is_apart = _gaps(tracks.mean, shape[found], rule) >= _APART_M
        if is_apart.all() and not _are_just_beyond(tracks, new, rule)[0]:
            both: dict[str, Any] = {
                n: np.concatenate([a, getattr(new, n)]) for n, a in _per_line(tracks).items()
            }
            tracks = replace(new, motion=tracks.motion, **both)
    # A line becomes valid with an excess of k, which without a miss is the largest LRI (the paper's
    # rule), and stays so until its LRI falls below a share of k.
    k = rule.lri_frames
    seen = (tracks.hits > 0).sum(axis=1)
    is_valid = (tracks.excess >= k) | (tracks.is_valid & (seen >= _VALID_UNTIL * k))
    tracks = replace(tracks, is_valid=is_valid, was_valid=tracks.was_valid | is_valid)
    return _without_lost(tracks, rule)


def lines_of(tracks: Tracks, rule: Rules) -> FrameLines:
    """Return the lines of a frame, left to right: the output of the detector."""
    n_votes = np.isfinite(tracks.votes).sum(axis=1)
    share = np.nansum(tracks.votes, axis=1) / np.maximum(n_votes, 1)
    is_continuous = share > _CONTINUOUS_SHARE
    offset = tracks.mean[:, 0]
    order = np.argsort(offset, kind="stable")
    if rule.hides_beyond:
        edges = offset[is_continuous & tracks.is_valid]
        left = edges[edges < 0].max(initial=-np.inf)
        right = edges[edges > 0].min(initial=np.inf)
        order = order[(offset[order] >= left) & (offset[order] <= right)]
    return FrameLines(
        tracks.mean[order], tracks.is_valid[order], is_continuous[order], tracks.lri[order]
    )


def gaps_beyond(tracks: Tracks, lines: FrameLines) -> FloatArray:
    """Return the distances, metres, of valid tracks from the outermost valid line of a frame on
    either side; negative for tracks between the two."""
    offset = tracks.mean[tracks.is_valid, 0]
    shown = lines.offset_m[lines.is_valid]
    return np.concatenate([shown[:1] - offset, offset - shown[-1:]])


def _match(tracks: Tracks, rule: Rules, shape: FloatArray) -> IntArray:
    """Match each line with the found line that continues it: its index, (L,), or -1."""
    gap = (shape[None, :, :] - tracks.mean[:, None, :]) @ rule.at.T
    spread = rule.at @ tracks.covariance @ rule.at.T + rule.noise
    variance = np.diagonal(spread, axis1=1, axis2=2)[:, None, :]
    sigmas = np.sqrt((gap**2 / variance).mean(axis=2))
    # The gate in metres uses the nearer half, because far ahead a small turn makes a large gap.
    metres = np.abs(gap[..., : _PLACES // 2]).mean(axis=2)
    return closest(np.where((metres <= rule.gate_m) & (sigmas <= _GATE_SIGMAS), metres, np.inf))


def closest(cost: FloatArray) -> IntArray:
    """Match rows with columns by their cost (R, C), infinite if they do not match, the cheapest
    pairs first: the column of each row, (R,), or -1. `cost` is changed."""
    taken = np.full(len(cost), -1, dtype=np.int64)
    while np.isfinite(cost).any():
        row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
        taken[row] = column
        cost[row, :] = cost[:, column] = np.inf
    return taken


def _update(
    tracks: Tracks,
    rule: Rules,
    matched: IntArray,
    shape: FloatArray,
    coverage: FloatArray,
    likely: FloatArray,
) -> Tracks:
    """Update the matched lines by a Kalman step, and count the hits and votes of all lines."""
    is_hit = matched >= 0
    found = matched[is_hit]
    # The motion of one line of several is not the car's.
    shows_motion = len(found) >= min(2, len(tracks))
    moved = (shape[found] - tracks.mean[is_hit]) @ rule.at.T
    shift = _common_shift(moved, rule) if shows_motion and len(found) else np.zeros(4)
    tracks = replace(tracks, mean=tracks.mean + _SHIFT_GAIN * shift)
    mean = tracks.mean.copy()
    covariance = tracks.covariance.copy()
    votes = tracks.votes.copy()
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
        excess=np.clip(tracks.excess + np.where(is_hit, 1.0, -_MISS_COST), 0.0, rule.lri_frames),
        missed=np.where(is_hit, 0, tracks.missed + 1),
        # Without matched lines the common motion decays.
        motion=(
            tracks.motion + _MOTION_GAIN * shift
            if shows_motion
            else tracks.motion * (1 - _MOTION_GAIN)
        ),
    )


def _common_shift(moved: FloatArray, rule: Rules) -> FloatArray:
    """Return the common change (4,) of offset, heading and, unless lines are straight, curvature.

    moved: (K, J) measured minus predicted positions of the matched lines, metres.
    """
    shift = np.zeros(4)
    weight = 1 / np.sqrt(np.diag(rule.noise))
    design = rule.at * weight[:, None]
    middle = np.median(moved, axis=0) * weight
    if rule.n_values > 2:
        shift[2] = _CURVATURE_GAIN * (np.linalg.pinv(design[:, :3])[2] @ middle)
        middle = middle - design[:, 2] * shift[2]
    shift[:2] = np.linalg.pinv(design[:, :2]) @ middle
    return shift


def _without_lost(tracks: Tracks, rule: Rules) -> Tracks:
    """Drop lines that were missed for too long, are too far to the side, or are too close to a
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
    """Return which of N lines, (N,), lie beyond a track, as viewed from the car, and too close to
    it for a lane. That track is valid, or is detected in this frame with at least the same LRI."""
    near = rule.at[: _PLACES // 2].mean(axis=0)
    place = (some.mean @ near)[:, None]
    places = tracks.mean @ near
    is_between = (np.sign(places) == np.sign(place)) & (np.abs(places) < np.abs(place))
    is_between &= tracks.number != some.number[:, None]
    is_close = _gaps(some.mean[:, None], tracks.mean, rule) < _LEAST_LANE_M
    is_good = tracks.is_valid | ((tracks.lri >= some.lri[:, None]) & (tracks.missed == 0))
    return np.asarray((is_between & is_close & is_good).any(axis=1))


def _gaps(means: FloatArray, others: FloatArray, rule: Rules) -> FloatArray:
    """Return the mean distance (...), metres, of lines (..., 4) from others (..., 4) in the nearer
    half of the distances ahead."""
    return np.asarray(np.abs((means - others) @ rule.at[: _PLACES // 2].T).mean(axis=-1))


def _per_line(tracks: Tracks) -> dict[str, Any]:
    """Return the arrays with an entry per line, by name."""
    shared = ("motion", "n_started")
    return {f.name: getattr(tracks, f.name) for f in fields(tracks) if f.name not in shared}


def _chosen(tracks: Tracks, which: IntArray) -> Tracks:
    return replace(tracks, **{name: a[which] for name, a in _per_line(tracks).items()})
