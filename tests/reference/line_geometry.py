"""The kernels of `evidence.line_geometry` in plain NumPy, same arguments; and the evidence that the
rule gives with these in their place."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from egolane_pgm.evidence.line_geometry import fitting, kernels, lane_width, reading, rule, scale
from egolane_pgm.evidence.line_geometry.kernels import DOUBLE, INERTIA, TICK_S, LastFrame
from egolane_pgm.evidence.line_geometry.model import LANE_M, REACH_M, LineModel
from egolane_pgm.evidence.line_geometry.scale import WidthBelief
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog, pad_and_concat


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """As `rule.evidence`."""
    with plain():
        return rule.evidence(log, n_lanes, parameters)


@contextmanager
def plain() -> Iterator[None]:
    """While this lasts, the rule computes with what is here."""
    twins = (
        count_ticks,
        follow_lines,
        coast,
        find_doubles,
        weigh_positions,
    )
    ours = {f.__name__: f for f in twins}
    with (
        patch.multiple(kernels, **ours),
        patch.multiple(scale, line_classes=line_classes, follow=follow),
        patch.object(reading, "line_classes", line_classes),
        patch.object(lane_width, "line_classes", line_classes),
    ):
        yield


def line_classes(
    offset_m: FloatArray, is_valid: BoolArray, is_continuous: BoolArray, lri: FloatArray
) -> tuple[IntArray, BoolArray]:
    """Return the class and whether the place is reliable, (T, L) each."""
    is_line = np.isfinite(offset_m) & (np.abs(offset_m) > scale.PLACEHOLDER_M)
    known = np.where(np.isnan(lri), np.inf, lri)
    is_strong = is_line & is_valid & (known >= scale.STRONG_LRI)
    classes = [is_valid & is_continuous, is_strong, is_valid, known >= scale.LEAST_LRI]
    return np.select([is_line & each for each in classes], [0, 1, 2, 3], -1), is_strong


def follow(belief: WidthBelief, offset_m: FloatArray, is_strong: BoolArray) -> FloatArray:
    """Return the widths (T, K); the belief becomes that after the last frame."""
    steady, wandering, pairs, counts, prior = belief
    width_m = np.empty((len(offset_m), scale.N_QUANTILES))
    n, n_quantiles = len(prior), width_m.shape[1]
    quantiles = (np.arange(n_quantiles) + 0.5) / n_quantiles

    def read(table: FloatArray, gap: float) -> FloatArray:
        """What the table says of each width for this gap; 0 beyond the table."""
        index = (
            round((np.log(gap) - scale._LOG_NARROWEST) / scale._STEP) - scale._FIRST - np.arange(n)
        )
        inside = (index >= 0) & (index < len(table))
        return np.where(inside, table[np.clip(index, 0, len(table) - 1)], 0.0)

    for offsets, strong, widths in zip(offset_m, is_strong, width_m, strict=True):
        steady[1:-1] += scale.STEADY_MOVES * np.diff(steady, 2)
        steady[:] = (1 - scale.ANOTHER_SCALE) * steady + scale.ANOTHER_SCALE * prior
        is_seen = (counts[1] < scale.ENOUGH_PAIRS) | (pairs >= scale.LEAST_PAIRS * counts[1])
        steady[~is_seen] *= 1e-60
        now = steady / steady.sum()
        around = np.convolve(np.where(now > 1e-6, now, 0), scale._SPREAD, mode="same")
        wandering += scale.WANDERING_MOVES * np.diff(np.pad(wandering, 1, mode="edge"), 2)
        wandering[:] = (1 - scale.RETURNS) * wandering + scale.RETURNS * around
        wandering[~is_seen] *= 1e-60
        wandering /= wandering.sum()
        counts[0] = (1 - scale.CHANGES) * counts[0] + scale.CHANGES * scale.MAY_WANDER
        below = np.cumsum(counts[0] * wandering + (1 - counts[0]) * now)
        widths[:] = np.exp(scale._LOG_NARROWEST + scale._STEP * np.searchsorted(below, quantiles))

        lines = np.sort(offsets[strong])
        if len(lines) < 2:
            continue
        single = [lines[0]]
        for line in lines[1:]:
            if line - single[-1] > scale.DOUBLE * np.diff(lines).max():
                single.append(line)
        neighbours, others = np.diff(single), np.subtract(single[2:], single[:-2])
        pairs *= scale.KEPT_PAIRS
        pairs += sum((read(scale._IS_TWO_LANES, gap) for gap in others), np.zeros(n))
        counts[1] = scale.KEPT_PAIRS * counts[1] + len(others)
        relative = scale._LOG_LIKELIHOOD - scale._LOG_LIKELIHOOD[0]
        likelihood = sum((read(relative, gap) for gap in (*neighbours, *others)), np.zeros(n))
        quick = np.exp(likelihood / scale.ALIKE_WANDERING)
        of_steady, of_wandering = now @ quick, wandering @ quick
        counts[0] *= of_wandering / (counts[0] * of_wandering + (1 - counts[0]) * of_steady)
        if len(neighbours):
            steady *= np.exp(likelihood / scale.ALIKE)
            steady /= steady.sum()
        wandering *= quick
        wandering /= wandering.sum()
    return width_m


def count_ticks(
    frame_id: IntArray, time_s: FloatArray, last: LastFrame
) -> tuple[IntArray, FloatArray, BoolArray, float]:
    """Return the ticks, the weights, whether frames are absent before, (T,), and the rest."""
    with np.errstate(invalid="ignore"):
        since = np.diff(time_s, prepend=last.time_s) / TICK_S
        since = np.where((since > 0) & (since < np.inf), np.round(since, 6), 1.0)
    steps = np.diff(frame_id, prepend=last.frame_id)
    if last.time_s == -np.inf:
        steps[:1] = 1
    passed = last.passed + np.cumsum(since)
    total = np.floor(passed + kernels.EARLY).astype(np.int64)
    ticks = np.diff(total, prepend=0)
    is_after_gap = (steps > 1) & (ticks > 1)
    weights = np.where(is_after_gap, np.maximum(since / steps, 1), since)
    return ticks, weights, is_after_gap, float((passed - total)[-1]) if len(total) else last.passed


def follow_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lri: FloatArray,
    is_missing: BoolArray,
    ticks: IntArray,
    is_after_gap: BoolArray,
    repeats_are_held: bool,
    width_m: FloatArray,
    farthest: float,
    reach: float,
    last: LastFrame,
) -> tuple[BoolArray, FloatArray, int]:
    """Return is_held (T, L), displacement (T,), NaN if unknown, and the last frame in which a tick
    begins; and write -1 to kind (T, L) of lines too far away."""
    n_frames = len(offset_m)
    displacement = np.full(n_frames, np.nan)
    is_held = np.zeros(offset_m.shape, dtype=bool)
    kind[~(np.abs(offset_m) < farthest * width_m[:, None])] = -1
    begins = np.flatnonzero(ticks > 0)
    begin = int(begins[-1]) if len(begins) else -1
    if offset_m.size == 0:
        return is_held, displacement, begin
    is_known = ~is_missing & ~is_after_gap
    # The lines of the frame before each, (T, K); frames may have different numbers of lines.
    just_m = pad_and_concat([last.offset_m[None], offset_m[:-1]], np.nan)
    just_lri = pad_and_concat([last.lri[None], lri[:-1]], np.nan)
    is_real = np.concatenate([[last.is_real], ~is_missing[:-1]])
    same = offset_m[:, :, None] == just_m[:, None, :]
    falls = lri[:, :, None] < just_lri[:, None, :]
    is_held[:] = (same & (falls | repeats_are_held)).any(axis=2) & (is_known & is_real)[:, None]
    # The lines of the frame with the tick before, for each frame with a tick.
    shown = np.where(is_missing[:, None], -1, kind)
    before_m = pad_and_concat([last.before_m[None], offset_m[begins]], np.nan)[:-1]
    before_kind = pad_and_concat([last.before_kind[None], shown[begins]], -1)[:-1]
    before_held = pad_and_concat([last.before_held[None], is_held[begins]], False)[:-1]
    if before_m.shape[1] == 0 or not len(begins):
        return is_held, displacement, begin
    now_m = offset_m[begins]
    with np.errstate(invalid="ignore"):
        distance = np.abs(now_m[:, :, None] - before_m[:, None, :])
    now = (kind[begins] >= 0) & ~is_held[begins] & is_known[begins][:, None]
    for take_held in (False, True):
        before = (before_kind >= 0) & (take_held | ~before_held)
        apart = np.where(now[:, :, None] & before[:, None, :], distance, np.inf)
        match = apart.argmin(axis=2)
        nearest = np.take_along_axis(apart, match[:, :, None], axis=2)[:, :, 0]
        rival = np.take_along_axis(apart.min(axis=1), match, axis=1)
        is_match = (nearest < reach * width_m[begins][:, None]) & (nearest <= rival)
        with np.errstate(invalid="ignore"):
            moves = now_m - np.take_along_axis(before_m, match, axis=1)
        moves = np.where(is_match, moves, np.nan)
        found = is_match.any(axis=1) & np.isnan(displacement[begins])
        displacement[begins[found]] = np.nanmedian(moves[found], axis=1) / width_m[begins[found]]
    return is_held, displacement, begin


def coast(
    displacement: FloatArray, ticks: IntArray, farthest: float, kept: float, first: float
) -> FloatArray:
    """Return the velocity (T + 1,)."""
    is_known = np.abs(displacement) < farthest
    # Each value is a share of the one before and a part of its own.
    share = np.where(is_known, (1 - 1 / INERTIA) ** ticks, kept**ticks)
    part = np.where(is_known, displacement / np.maximum(ticks, 1) * (1 - share), 0.0)
    velocity = [first]
    for t in range(len(ticks)):
        velocity.append(share[t] * velocity[t] + part[t])
    return np.array(velocity)


def find_doubles(
    offset_m: FloatArray, kind: IntArray, width_m: FloatArray, before: IntArray
) -> tuple[BoolArray, IntArray]:
    """Return is_double (T, L), and the numbers of lines and doubles (T + 1, 2)."""
    counts = kind >= 0
    offset = np.where(counts, offset_m, np.inf)
    with np.errstate(invalid="ignore"):
        is_near = np.abs(offset[:, :, None] - offset[:, None, :]) < DOUBLE * width_m[:, None, None]
    # Class, then distance, then place in the list; lexsort has its first key last.
    place = np.broadcast_to(np.arange(kind.shape[1]), kind.shape)
    rank = np.argsort(np.lexsort((place, np.abs(offset), kind), axis=1), axis=1)
    is_better = rank[:, None, :] < rank[:, :, None]
    both = counts[:, :, None] & counts[:, None, :]
    is_double = (is_near & is_better & both).any(axis=2)
    of_frame = np.stack([counts.sum(axis=1), is_double.sum(axis=1)], axis=1)
    return is_double, before + np.concatenate([[[0, 0]], of_frame.cumsum(axis=0)])


def weigh_positions(
    offset_m: FloatArray,
    kind: IntArray,
    width_m: FloatArray,
    log_intensity: FloatArray,
    log_mean: FloatArray,
    first_m: float,
    step_m: float,
    expected: FloatArray,
    model_width_m: float,
    alpha: float,
    beta: float,
    weights: FloatArray,
    is_missing: BoolArray,
    lane_changes: float,
    kind_changes: float,
    visibility: FloatArray,
    patterns: FloatArray,
    likelihood: FloatArray,
    last_kind: FloatArray,
) -> None:
    """Write likelihood (T, n cells, 2), each frame's maximum 1, the belief `visibility` and the
    `patterns` after the last frame, and the probability of the last kind before each, (T,)."""
    (n_lanes, n_kinds), n_points = visibility.shape, log_mean.shape[1]
    cells, n_widths = likelihood.shape[1] // n_lanes, width_m.shape[1]
    of_state = np.zeros((n_widths, len(offset_m), n_kinds * n_lanes, cells))
    mean = np.zeros((n_widths, len(offset_m), cells))
    centre_m = (np.arange(cells) + 0.5) / cells * model_width_m - model_width_m / 2
    for w, i in np.ndindex(n_widths, offset_m.shape[1]):
        frames = np.flatnonzero(kind[:, i] >= 0)
        c = kind[frames, i][:, None]
        scaled = offset_m[frames, i] / width_m[frames, w] * model_width_m
        at = (scaled[:, None] + centre_m - first_m) / step_m
        # Beyond the tables, everything is as at their ends.
        at = np.clip(at, 0, n_points - 2)
        z = at.astype(np.int64)
        right = at - z
        for state in range(n_kinds * n_lanes):
            table = log_intensity[..., state]
            of_state[w, frames, state] += (1 - right) * table[c, z] + right * table[c, z + 1]
        mean[w, frames] += (1 - right) * log_mean[c, z] + right * log_mean[c, z + 1]
    # The likelihood of the lines is its mean over the widths.
    log_p = np.logaddexp.reduce(of_state) - np.log(n_widths)
    log_p = log_p.reshape(len(offset_m), n_kinds, n_lanes, cells) - expected[..., None]
    log_mean_p = np.logaddexp.reduce(mean) - np.log(n_widths) - expected.mean()
    known = (log_p - log_mean_p[:, None, None]).transpose(0, 2, 1, 3)
    # The car is in the lane that it was in, or in the one on either side, if there is one.
    to_side = np.eye(n_lanes, k=1) + np.eye(n_lanes, k=-1)
    np.fill_diagonal(to_side, 2 - to_side.sum(axis=1))
    alphas, betas = (np.minimum(each * weights, max(each, 1.0)) for each in (alpha, beta))
    sides = [((kind >= 0) & each).sum(axis=1) for each in (offset_m < 0, offset_m >= 0)]
    left, right = (np.minimum(side, kernels.MOST_BESIDE) for side in sides)
    alphas[is_missing | (left + right == 0)] = 0.0
    for t in range(len(offset_m)):
        same, more = patterns[left[t], right[t]], patterns[left[t] :, right[t] :].sum()
        seen = same + kernels.OF_FEWER * (more - same)
        fresh = 1 / (1 + max(seen - kernels.FRESH, 0) / kernels.TIRES) ** 2
        patterns *= np.exp(-weights[t] / kernels.REMEMBERED)
        patterns[left[t], right[t]] += weights[t]
        last_kind[t] = visibility[:, -1].sum()
        moves, changes = (min(rate * weights[t], 0.3) for rate in (lane_changes, kind_changes))
        visibility[:] = (1 - 2 * moves) * visibility + moves * to_side @ visibility
        visibility[:] = (1 - changes) * visibility + changes * visibility.mean(
            axis=1, keepdims=True
        )
        share = visibility / visibility.sum(axis=1, keepdims=True)
        of_kinds = (share[:, :, None] * np.exp(fresh * alphas[t] * known[t])).sum(axis=1)
        log_likelihood = np.empty((n_lanes, cells, 2))
        log_likelihood[..., 1] = betas[t] * log_mean_p[t]
        log_likelihood[..., 0] = log_likelihood[..., 1] + np.log(of_kinds)
        likelihood[t] = np.exp(log_likelihood - log_likelihood.max()).reshape(-1, 2)
        place = np.exp(log_mean_p[t] - log_mean_p[t].max())
        visibility *= ((np.exp(known[t]) * place).sum(axis=2) / place.sum()) ** alphas[t]
        visibility /= visibility.sum()


def log_prior(model: LineModel, first: LineModel) -> float:
    """Return the logarithm of the prior density of a fit, up to a constant."""
    metres = 2 * REACH_M * len(model.rates)
    away = (model.shoulders - first.shoulders) * LANE_M / first.sigmas_m[-2:]
    value = (first.rates * np.log(model.rates)).sum() - model.rates.sum()
    value += (first.class_shares * np.log(model.class_shares)).sum()
    value += metres * ((first.clutter * np.log(model.clutter)).sum() - model.clutter.sum())
    value -= np.log(model.sigmas_m).sum() + 0.5 * ((first.sigmas_m / model.sigmas_m) ** 2).sum()
    return fitting.STRENGTH * float(value - 0.5 * (away**2).sum())
