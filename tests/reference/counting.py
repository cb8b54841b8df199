"""The paper's counting of lines in plain NumPy: what `egolane_pgm.evidence.counting` is held to."""

from __future__ import annotations

import numpy as np

from egolane_pgm.evidence.counting import WOR_NOISE
from egolane_pgm.parameters import Parameters
from egolane_pgm.types import Evidence, LineLog


def evidence(log: LineLog, n_lanes: int, parameters: Parameters) -> Evidence:
    """DetectorOutput (T, n) and WOR (T, 2) of T frames."""
    lane_width_m = float(parameters["lane_width_m"])
    bonus_value = float(parameters["bonus_value"])
    max_lri = float(parameters["max_lri"])
    d = np.where(log.is_valid, log.offset_m, 0.0)
    distance = np.abs(d)
    is_far = log.is_valid & (distance > lane_width_m)
    reach = (np.arange(n_lanes) + 1) * lane_width_m
    # votes[..., k]: for a line to the right, the k-th lane from the right; else from the left.
    votes = (is_far[..., None] & (distance[..., None] < reach)).astype(np.float64)
    bonus_lane = np.minimum(distance / lane_width_m, n_lanes).astype(np.int64)
    has_bonus = is_far & log.is_continuous & (bonus_lane < n_lanes)
    votes += bonus_value * (has_bonus[..., None] & (bonus_lane[..., None] == np.arange(n_lanes)))
    is_right = (d > 0)[..., None]
    counts = np.where(is_right, votes[..., ::-1], votes).sum(axis=1)
    is_near = log.is_valid & ~is_far & log.is_continuous
    counts[:, 0] += bonus_value * (is_near & (d < 0)).sum(axis=1)
    counts[:, -1] += bonus_value * (is_near & (d >= 0)).sum(axis=1)
    counts[counts.sum(axis=1) == 0] = 1.0
    counts += float(parameters["tentative_noise"])
    tentative = counts / counts.sum(axis=1, keepdims=True)
    known = np.where(np.isnan(log.lri), max_lri, log.lri)
    s = np.where(log.is_valid, known, 0.0).sum(axis=1) / (max_lri * (n_lanes + 1)) - WOR_NOISE
    s = np.where(s < 0, WOR_NOISE, np.where(s >= 1, 1 - WOR_NOISE, s))
    return Evidence({"DetectorOutput": tentative, "WOR": np.stack([s, 1 - s], axis=1)})
