"""From the lines found in single frames to lines followed over time (paper, section "Line detection
and tracking": each line's parameters are updated by a Kalman filter, the LRI counts detections).

A line is y(x) = s0 + s1 x + s2 x^2 / 2 + s3 x^3 / 6. What is measured is where it lies at some
distances ahead, because there it was seen: its offset at the car is an extrapolation. The car's own
motion moves all lines alike, so one shift per frame is estimated for all of them together.
NumPy only; nothing here has seen a picture.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from egolane_pgm.detectors import FrameLines
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: How many distances ahead a line is compared at; four parameters need four.
_PLACES = 4

#: What a new line's detection leaves open is taken for as wide as so many steps of the walk.
_OPEN_STEPS = 50


@dataclass(frozen=True)
class Tracks:
    """The L lines that are followed, in no order.

    number (L,): which line it is, for as long as it is followed. mean (L, 4), covariance
    (L, 4, 4): its parameters. hits (L, k): whether it was detected, the newest frame last.
    votes (L, v): 1 continuous, 0 dashed, NaN none, of its last detections. missed (L,): frames
    since the last one. is_valid, was_valid (L,). motion (4,): the change of the parameters per
    frame that all lines share. born: lines so far.
    """

    number: IntArray
    mean: FloatArray
    covariance: FloatArray
    hits: BoolArray
    votes: FloatArray
    missed: IntArray
    is_valid: BoolArray
    was_valid: BoolArray
    motion: FloatArray
    born: int = 0

    def __len__(self) -> int:
        return len(self.number)

    @property
    def lri(self) -> IntArray:
        """(L,): detections in the last k frames."""
        detections: IntArray = self.hits.sum(axis=1)
        return detections


@dataclass(frozen=True)
class Rules:
    """The parameters and what follows from them. at (J, 4): takes a line's parameters to its places
    at J distances ahead; noise (J, J), walk (4, 4): of the measurement and of a frame's step;
    first (4, 4): of a line detected once. curved: lines have curvature (clothoids), else they are
    straight."""

    values: Parameters
    curved: bool
    at: FloatArray
    noise: FloatArray
    walk: FloatArray
    first: FloatArray

    def __getitem__(self, name: str) -> float:
        return float(self.values[name])  # type: ignore[arg-type]


def rules(parameters: Parameters, *, curved: bool) -> Rules:
    """The rules of tracking from resolved values of the parameters."""

    def value(name: str) -> float:
        return float(parameters[name])  # type: ignore[arg-type]

    near = value("track_near_m")
    x = np.linspace(near, max(value("track_far_m"), near + 1.0), _PLACES)
    at = np.stack([np.ones_like(x), x, x**2 / 2, x**3 / 6], axis=1)
    sigma = np.linspace(value("measure_sigma_m"), value("measure_sigma_far_m"), _PLACES)
    noise = np.diag(sigma**2)
    names = ("offset_walk_m", "heading_walk", "curvature_walk", "rate_walk")
    walk = np.array([value(name) for name in names])
    if not curved:
        walk[2:] = 0.0
    inverse = np.linalg.pinv(at)
    first = inverse @ noise @ inverse.T
    narrower = np.minimum(1.0, _OPEN_STEPS * walk / np.sqrt(np.diag(first)))
    first *= narrower[:, None] * narrower
    return Rules(parameters, curved, at, noise, np.diag(walk**2), first)


def no_tracks(rule: Rules) -> Tracks:
    """Before the first frame."""
    n_hits, n_votes = int(rule["lri_frames"]), int(rule["vote_frames"])
    return Tracks(
        number=np.zeros(0, dtype=np.int64),
        mean=np.zeros((0, 4)),
        covariance=np.zeros((0, 4, 4)),
        hits=np.zeros((0, n_hits), dtype=bool),
        votes=np.zeros((0, n_votes)),
        missed=np.zeros(0, dtype=np.int64),
        is_valid=np.zeros(0, dtype=bool),
        was_valid=np.zeros(0, dtype=bool),
        motion=np.zeros(4),
    )


def expected(tracks: Tracks) -> FloatArray:
    """(K, 4): where the lines should be in the next frame, left to right: those that are valid, or
    all where none is."""
    shapes = tracks.mean[tracks.is_valid | ~tracks.is_valid.any()] + tracks.motion
    return shapes[np.argsort(shapes[:, 0], kind="stable")]


def advance(tracks: Tracks, rule: Rules, shape: FloatArray, coverage: FloatArray) -> Tracks:
    """The tracks after a frame in which lines `shape` (M, 4) were found, of which the shares
    `coverage` (M,) are painted (NaN: that cannot be told)."""
    if not rule.curved:
        shape = np.concatenate([shape[:, :2], np.zeros((len(shape), 2))], axis=1)
    tracks = replace(
        tracks, mean=tracks.mean + tracks.motion, covariance=tracks.covariance + rule.walk
    )
    matched = _match(tracks, rule, shape)
    tracks = _update(tracks, rule, matched, shape, coverage)
    is_new = np.ones(len(shape), dtype=bool)
    is_new[matched[matched >= 0]] = False
    for found in np.flatnonzero(is_new):
        new = _born(tracks, rule, shape[found], coverage[found])
        is_apart = _gaps(tracks.mean, shape[found], rule) >= rule["tracks_apart_m"]
        if is_apart.all() and not _bounds_nothing(tracks, new, rule):
            tracks = _joined(tracks, new)
    return _without_lost(_judged(tracks, rule), rule)


def lines_of(tracks: Tracks, rule: Rules) -> FrameLines:
    """What the detector says of its tracks, left to right."""
    is_continuous = continuous_share(tracks) > rule["continuous_share"]
    order = np.argsort(tracks.mean[:, 0], kind="stable")
    order = order[~_is_hidden(tracks, is_continuous, rule)[order]]
    return FrameLines(
        tracks.mean[order],
        tracks.is_valid[order],
        is_continuous[order],
        tracks.lri[order].astype(np.float64),
    )


def _is_hidden(tracks: Tracks, is_continuous: BoolArray, rule: Rules) -> BoolArray:
    """(L,): the lines that `beyond_edge` keeps back."""
    choice, offset = rule.values["beyond_edge"], tracks.mean[:, 0]
    edges = offset[is_continuous & tracks.is_valid]
    left, right = edges[edges < 0].max(initial=-np.inf), edges[edges > 0].min(initial=np.inf)
    is_beyond: BoolArray = (offset < left) | (offset > right)
    if choice == "keep":
        return np.zeros_like(is_beyond)
    return is_beyond if choice == "hide_all" else is_beyond & is_continuous


def continuous_share(tracks: Tracks) -> FloatArray:
    """(L,): the share of each line's votes that is for continuous; 0 without a vote."""
    n_votes = np.isfinite(tracks.votes).sum(axis=1)
    share: FloatArray = np.nansum(tracks.votes, axis=1) / np.maximum(n_votes, 1)
    return share


def _match(tracks: Tracks, rule: Rules, shape: FloatArray) -> IntArray:
    """(L,): for each line the found one that continues it, or -1; the closest pairs first."""
    taken = np.full(len(tracks), -1, dtype=np.int64)
    if not len(tracks) or not len(shape):
        return taken
    gap = (shape[None, :, :] - tracks.mean[:, None, :]) @ rule.at.T
    spread = rule.at @ tracks.covariance @ rule.at.T + rule.noise
    variance = np.diagonal(spread, axis1=1, axis2=2)[:, None, :]
    sigmas = np.sqrt((gap**2 / variance).mean(axis=2))
    # Of the gate in metres the nearer half: far ahead a small turn of the car is a large gap.
    metres = np.abs(gap[..., : _PLACES // 2]).mean(axis=2)
    cost = np.where((metres <= rule["gate_m"]) & (sigmas <= rule["gate_sigmas"]), metres, np.inf)
    while np.isfinite(cost).any():
        line, found = np.unravel_index(int(np.argmin(cost)), cost.shape)
        taken[line] = found
        cost[line, :] = np.inf
        cost[:, found] = np.inf
    return taken


def _update(
    tracks: Tracks, rule: Rules, matched: IntArray, shape: FloatArray, coverage: FloatArray
) -> Tracks:
    """Kalman update of the matched lines, and the count of hits and votes of all."""
    is_hit = matched >= 0
    found = matched[is_hit]
    tells = len(found) >= min(2, len(tracks))
    shift = _common_shift((shape[found] - tracks.mean[is_hit]) @ rule.at.T, rule, tells)
    tracks = replace(tracks, mean=tracks.mean + rule["shift_gain"] * shift)
    mean, covariance, votes = tracks.mean.copy(), tracks.covariance.copy(), tracks.votes.copy()
    prior = covariance[is_hit]
    spread = rule.at @ prior @ rule.at.T + rule.noise
    gain = np.linalg.solve(spread, rule.at @ prior).transpose(0, 2, 1)
    surprise = (shape[found] - mean[is_hit]) @ rule.at.T
    mean[is_hit] += np.einsum("lij,lj->li", gain, surprise)
    # Joseph's form, which stays symmetric and positive.
    kept = np.eye(4) - gain @ rule.at
    covariance[is_hit] = kept @ prior @ kept.transpose(0, 2, 1) + gain @ rule.noise @ (
        gain.transpose(0, 2, 1)
    )
    is_known = np.isfinite(coverage[found])
    voting = np.flatnonzero(is_hit)[is_known]
    vote = coverage[found][is_known] >= rule["continuous_cover"]
    votes[voting] = np.concatenate([votes[voting][:, 1:], vote[:, None]], axis=1)
    return replace(
        tracks,
        mean=mean,
        covariance=covariance,
        votes=votes,
        hits=np.concatenate([tracks.hits[:, 1:], is_hit[:, None]], axis=1),
        missed=np.where(is_hit, 0, tracks.missed + 1),
        motion=_steady(tracks.motion, shift, rule["motion_gain"], tells),
    )


def _common_shift(surprise: FloatArray, rule: Rules, tells: bool) -> FloatArray:
    """(4,): the change of offset and heading that most of the matched lines show at their places
    (K, J). tells: whether they tell about the car: one of several lines may have moved alone."""
    shift = np.zeros(4)
    if len(surprise) and tells:
        weight = 1 / np.sqrt(np.diag(rule.noise))
        moved = np.median(surprise, axis=0)
        shift[:2] = np.linalg.lstsq(rule.at[:, :2] * weight[:, None], moved * weight)[0]
    return shift


def _steady(motion: FloatArray, shift: FloatArray, gain: float, tells: bool) -> FloatArray:
    """The steady motion after a shift beyond it; it comes to rest where the lines do not tell."""
    return motion + gain * shift if tells else motion * (1 - gain)


def _born(tracks: Tracks, rule: Rules, shape: FloatArray, coverage: float) -> Tracks:
    """The one track of a line detected for the first time."""
    hits = np.zeros((1, tracks.hits.shape[1]), dtype=bool)
    hits[0, -1] = True
    votes = np.full((1, tracks.votes.shape[1]), np.nan)
    if np.isfinite(coverage):
        votes[0, -1] = coverage >= rule["continuous_cover"]
    return Tracks(
        number=np.array([tracks.born + 1]),
        mean=shape[None].astype(np.float64),
        covariance=rule.first[None],
        hits=hits,
        votes=votes,
        missed=np.zeros(1, dtype=np.int64),
        is_valid=np.zeros(1, dtype=bool),
        was_valid=np.zeros(1, dtype=bool),
        motion=tracks.motion,
        born=tracks.born + 1,
    )


def _judged(tracks: Tracks, rule: Rules) -> Tracks:
    """Valid from the largest LRI on, until it is below a share of it."""
    k = tracks.hits.shape[1]
    is_valid = (tracks.lri == k) | (tracks.is_valid & (tracks.lri >= rule["valid_until"] * k))
    return replace(tracks, is_valid=is_valid, was_valid=tracks.was_valid | is_valid)


def _without_lost(tracks: Tracks, rule: Rules) -> Tracks:
    """Without lines not seen for long, far to the side, or beside a better one."""
    patience = np.where(tracks.was_valid, rule["die_after"], rule["new_die_after"])
    is_good = (tracks.missed < patience) & (np.abs(tracks.mean[:, 0]) <= rule["farthest_m"])
    tracks = _chosen(tracks, np.flatnonzero(is_good))
    best_first = np.lexsort((tracks.number, -tracks.lri, ~tracks.is_valid))
    kept: list[int] = []
    for k in best_first:
        one = _chosen(tracks, np.array([k]))
        is_apart = _gaps(tracks.mean[kept], tracks.mean[k], rule) >= rule["tracks_apart_m"]
        if is_apart.all() and not _bounds_nothing(tracks, one, rule):
            kept.append(int(k))
    return _chosen(tracks, np.sort(np.array(kept, dtype=np.int64)))


def _bounds_nothing(tracks: Tracks, one: Tracks, rule: Rules) -> bool:
    """Whether a line lies close beyond one that is valid, or seen now and as often."""
    near = rule.at[: _PLACES // 2].mean(axis=0)
    place, places = float(one.mean[0] @ near), tracks.mean @ near
    is_between = (np.sign(places) == np.sign(place)) & (np.abs(places) < np.abs(place))
    is_between &= tracks.number != one.number
    is_close = _gaps(tracks.mean, one.mean[0], rule) < rule["least_lane_m"]
    is_good = tracks.is_valid | ((tracks.lri >= one.lri) & (tracks.missed == 0))
    return bool((is_between & is_close & is_good).any())


def _gaps(means: FloatArray, shape: FloatArray, rule: Rules) -> FloatArray:
    """(L,): metres between lines (L, 4) and one (4,), in the nearer half of where they are seen."""
    gaps: FloatArray = np.abs((means - shape) @ rule.at[: _PLACES // 2].T).mean(axis=1)
    return gaps


def _per_line(tracks: Tracks) -> dict[str, Any]:
    shared = ("motion", "born")
    return {f.name: getattr(tracks, f.name) for f in fields(tracks) if f.name not in shared}


def _chosen(tracks: Tracks, which: IntArray) -> Tracks:
    few = {name: a[which] for name, a in _per_line(tracks).items()}
    return replace(tracks, **few)


def _joined(tracks: Tracks, more: Tracks) -> Tracks:
    two = _per_line(more)
    both: dict[str, Any] = {
        name: np.concatenate([a, two[name]]) for name, a in _per_line(tracks).items()
    }
    return replace(more, **both)
