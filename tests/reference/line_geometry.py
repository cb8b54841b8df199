"""The kernels of `evidence.line_geometry` in plain NumPy, same arguments; and the evidence that the
rule gives with these in their place."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from egolane_pgm.evidence.line_geometry import flag_semantics, kernels, rule, scale
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
        follow_lines,
        coast,
        weigh_frames,
        find_doubles,
        weigh_positions,
    )
    ours = {f.__name__: f for f in twins}
    with (
        patch.multiple(kernels, **ours),
        patch.object(flag_semantics, "classify", classify),
        patch.object(scale, "follow_width", follow_width),
    ):
        yield


def classify(
    offset_m: FloatArray,
    is_valid: BoolArray,
    is_continuous: BoolArray,
    lri: FloatArray,
    strong_lri: float,
    least_lri: float,
    placeholder_m: float,
    kind: IntArray,
    is_strong: BoolArray,
) -> None:
    """Write kind (T, L) and is_strong (T, L)."""
    is_line = np.isfinite(offset_m) & (np.abs(offset_m) > placeholder_m)
    known = np.where(np.isnan(lri), np.inf, lri)
    is_strong[:] = is_line & is_valid & (known >= strong_lri)
    classes = [is_valid & is_continuous, is_strong, is_valid, known >= least_lri]
    kind[:] = np.select([is_line & each for each in classes], [0, 1, 2, 3], -1)


def follow_width(
    offset_m: FloatArray,
    is_strong: BoolArray,
    steady: FloatArray,
    wandering: FloatArray,
    pairs: FloatArray,
    counts: FloatArray,
    prior: FloatArray,
    log_likelihood: FloatArray,
    is_two_lanes: FloatArray,
    first: int,
    spread: FloatArray,
    rates: FloatArray,
    least_double: float,
    enough_pairs: float,
    least_pairs: float,
    log_narrowest: float,
    step: float,
    width_m: FloatArray,
) -> None:
    """Write width_m (T, K), and the belief after the last frame."""
    moves, moves_wandering, another, returns, may_wander, changes = rates[:6]
    kept, alike, alike_wandering = rates[6:]
    n, n_quantiles = len(prior), width_m.shape[1]
    quantiles = (np.arange(n_quantiles) + 0.5) / n_quantiles

    def read(table: FloatArray, gap: float) -> FloatArray:
        """What the table says of each width for this gap; 0 beyond the table."""
        index = round((np.log(gap) - log_narrowest) / step) - first - np.arange(n)
        inside = (index >= 0) & (index < len(table))
        return np.where(inside, table[np.clip(index, 0, len(table) - 1)], 0.0)

    for offsets, strong, widths in zip(offset_m, is_strong, width_m, strict=True):
        steady[1:-1] += moves * np.diff(steady, 2)
        steady[:] = (1 - another) * steady + another * prior
        is_seen = (counts[1] < enough_pairs) | (pairs >= least_pairs * counts[1])
        steady[~is_seen] *= 1e-60
        now = steady / steady.sum()
        around = np.convolve(np.where(now > 1e-6, now, 0), spread, mode="same")
        wandering += moves_wandering * np.diff(np.pad(wandering, 1, mode="edge"), 2)
        wandering[:] = (1 - returns) * wandering + returns * around
        wandering[~is_seen] *= 1e-60
        wandering /= wandering.sum()
        counts[0] = (1 - changes) * counts[0] + changes * may_wander
        below = np.cumsum(counts[0] * wandering + (1 - counts[0]) * now)
        widths[:] = np.exp(log_narrowest + step * np.searchsorted(below, quantiles))

        lines = np.sort(offsets[strong])
        if len(lines) < 2:
            continue
        single = [lines[0]]
        for line in lines[1:]:
            if line - single[-1] > least_double * np.diff(lines).max():
                single.append(line)
        neighbours, others = np.diff(single), np.subtract(single[2:], single[:-2])
        pairs *= kept
        pairs += sum((read(is_two_lanes, gap) for gap in others), np.zeros(n))
        counts[1] = kept * counts[1] + len(others)
        relative = log_likelihood - log_likelihood[0]
        says = sum((read(relative, gap) for gap in (*neighbours, *others)), np.zeros(n))
        quick = np.exp(says / alike_wandering)
        of_steady, of_wandering = now @ quick, wandering @ quick
        counts[0] *= of_wandering / (counts[0] * of_wandering + (1 - counts[0]) * of_steady)
        if len(neighbours):
            steady *= np.exp(says / alike)
            steady /= steady.sum()
        wandering *= quick
        wandering /= wandering.sum()


def weigh_frames(
    time_s: FloatArray, is_missing: BoolArray, usual_s: float, last_s: float, weights: FloatArray
) -> float:
    """Write weights (T,)."""
    real_s = np.maximum.accumulate([last_s, *np.where(is_missing, -np.inf, time_s)])
    with np.errstate(invalid="ignore"):
        passed = time_s - real_s[:-1]
        is_known = np.isfinite(passed) & (passed > 0)
        weights[:] = np.where(is_known, np.round(passed / usual_s, 6), 1.0)
    return float(real_s[-1])


def follow_lines(
    offset_m: FloatArray,
    kind: IntArray,
    lri: FloatArray,
    frame_id: IntArray,
    is_missing: BoolArray,
    repeats_are_held: bool,
    width_m: FloatArray,
    farthest: float,
    reach: float,
    last_offset_m: FloatArray,
    last_kind: IntArray,
    last_lri: FloatArray,
    last_is_held: BoolArray,
    last_id: int,
    last_state: int,
    is_held: BoolArray,
    displacement: FloatArray,
    steps: IntArray,
) -> None:
    """Write is_held (T, L), displacement (T,), NaN where unknown, and steps (T,); and kind (T, L)
    -1 where a line is too far away."""
    displacement[:] = np.nan
    is_held[:] = False
    kind[~(np.abs(offset_m) < farthest * width_m[:, None])] = -1
    if len(offset_m) == 0:
        return
    steps[:] = np.diff(frame_id, prepend=last_id if last_state >= 0 else frame_id[0] - 1)
    is_real = np.concatenate([[last_state == 1], ~is_missing])
    follows = is_real[1:] & is_real[:-1] & (steps == 1)
    if offset_m.shape[1] == 0:
        return
    # The lines of the frame before each, (T, K); frames may have different numbers of lines.
    before_m = pad_and_concat([last_offset_m[None], offset_m[:-1]], np.nan)
    before_kind = pad_and_concat([last_kind[None], kind[:-1]], -1)
    before_lri = pad_and_concat([last_lri[None], lri[:-1]], np.nan)
    if before_m.shape[1] == 0:
        return
    same = offset_m[:, :, None] == before_m[:, None, :]
    falls = lri[:, :, None] < before_lri[:, None, :]
    is_held[:] = (same & (falls | repeats_are_held)).any(axis=2) & follows[:, None]
    before_held = pad_and_concat([last_is_held[None], is_held[:-1]], False)
    with np.errstate(invalid="ignore"):
        distance = np.abs(offset_m[:, :, None] - before_m[:, None, :])
    now = (kind >= 0) & ~is_held & follows[:, None]
    for take_held in (False, True):
        before = (before_kind >= 0) & (take_held | ~before_held)
        apart = np.where(now[:, :, None] & before[:, None, :], distance, np.inf)
        match = apart.argmin(axis=2)
        nearest = np.take_along_axis(apart, match[:, :, None], axis=2)[:, :, 0]
        rival = np.take_along_axis(apart.min(axis=1), match, axis=1)
        is_match = (nearest < reach * width_m[:, None]) & (nearest <= rival)
        with np.errstate(invalid="ignore"):
            moves = offset_m - np.take_along_axis(before_m, match, axis=1)
        moves = np.where(is_match, moves, np.nan)
        found = is_match.any(axis=1) & np.isnan(displacement)
        displacement[found] = np.nanmedian(moves[found], axis=1) / width_m[found]


def coast(
    displacement: FloatArray,
    steps: IntArray,
    farthest: float,
    inertia: float,
    kept: float,
    velocity: FloatArray,
) -> None:
    """Write velocity (T + 1,), whose first value is given."""
    is_known = (np.abs(displacement) < farthest) & (steps == 1)
    # Each value is a share of the one before and a part of its own.
    share = np.where(is_known, 1 - 1 / inertia, kept**steps)
    part = np.where(is_known, displacement / inertia, 0.0)
    for t in range(len(steps)):
        velocity[t + 1] = share[t] * velocity[t] + part[t]


def find_doubles(
    offset_m: FloatArray,
    kind: IntArray,
    width_m: FloatArray,
    near: float,
    is_double: BoolArray,
    lines: IntArray,
) -> None:
    """Write is_double (T, L), and lines (T + 1, 2), whose first row is given."""
    counts = kind >= 0
    offset = np.where(counts, offset_m, np.inf)
    with np.errstate(invalid="ignore"):
        is_near = np.abs(offset[:, :, None] - offset[:, None, :]) < near * width_m[:, None, None]
    # Class, then distance, then place in the list; lexsort has its first key last.
    place = np.broadcast_to(np.arange(kind.shape[1]), kind.shape)
    rank = np.argsort(np.lexsort((place, np.abs(offset), kind), axis=1), axis=1)
    is_better = rank[:, None, :] < rank[:, :, None]
    both = counts[:, :, None] & counts[:, None, :]
    is_double[:] = (is_near & is_better & both).any(axis=2)
    of_frame = np.stack([counts.sum(axis=1), is_double.sum(axis=1)], axis=1)
    lines[1:] = lines[0] + of_frame.cumsum(axis=0)


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
    tenths: FloatArray,
    is_missing: BoolArray,
    lane_changes: float,
    kind_changes: float,
    visibility: FloatArray,
    likelihood: FloatArray,
) -> None:
    """Write likelihood (T, n cells, 2), each frame's maximum 1, and the belief `visibility` after
    the last frame."""
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
    alphas, betas = (np.minimum(each * tenths, max(each, 1.0)) for each in (alpha, beta))
    alphas[is_missing] = 0.0
    for t in range(len(offset_m)):
        moves, changes = (min(rate * tenths[t], 0.3) for rate in (lane_changes, kind_changes))
        visibility[:] = (1 - 2 * moves) * visibility + moves * to_side @ visibility
        visibility[:] = (1 - changes) * visibility + changes * visibility.mean(
            axis=1, keepdims=True
        )
        share = visibility / visibility.sum(axis=1, keepdims=True)
        of_kinds = (share[:, :, None] * np.exp(alphas[t] * known[t])).sum(axis=1)
        log_likelihood = np.empty((n_lanes, cells, 2))
        log_likelihood[..., 1] = betas[t] * log_mean_p[t]
        log_likelihood[..., 0] = log_likelihood[..., 1] + np.log(of_kinds)
        likelihood[t] = np.exp(log_likelihood - log_likelihood.max()).reshape(-1, 2)
        place = np.exp(log_mean_p[t] - log_mean_p[t].max())
        visibility *= ((np.exp(known[t]) * place).sum(axis=2) / place.sum()) ** alphas[t]
        visibility /= visibility.sum()
