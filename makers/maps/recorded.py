"""What the positions of two recorded drives tell of the lane, without any lines."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from makers.maps._drives import data
from tests.kits.gnss_alone import AloneNoise
from tests.kits.tracks import (
    ChangeAnswers,
    munich,
    munich_more,
    rotterdam_lanes,
    rotterdam_receivers,
    rotterdam_road,
)

#: What is chosen from without the block of changes that is scored.
GRID = tuple(product((0.6, 1.0), (1.5, 2.0, 2.5), (25.0, 300.0), (1, 5)))

N_BLOCKS = 5


def measure() -> Iterator[str]:
    """Lines of a table for Rotterdam, and two sentences for Munich."""
    yield from _rotterdam()
    yield ""
    drive = munich(data())
    wrong = (drive.road == "A 92") & (drive.lane > drive.n_lanes)
    stretch = drive[drive.run == drive.run[wrong].iloc[0]]
    is_wrong = (stretch.lane > stretch.n_lanes).to_numpy()
    right = drive[(drive.road == "A 9") & (drive.n_lanes == 4)]
    for what, part, rows in (("A 92", stretch, is_wrong), ("A 9", right, slice(None))):
        said = [munich_more(part, smooth=smooth)[rows] for smooth in (False, True)]
        yield (
            f"Munich, {what}: mean P(more lanes than the map says) over {len(said[0])} seconds:"
            f" {said[0].mean():.2f} by the past, {said[1].mean():.3f} with hindsight."
        )


def _rotterdam() -> Iterator[str]:
    place = rotterdam_road(data())
    receivers = rotterdam_receivers(data())

    def answers(noise: AloneNoise, every: int) -> list[ChangeAnswers]:
        return [rotterdam_lanes(data(), *place, r, noise, every=every) for r in receivers.values()]

    certain = {"count_wrong": 0.0, "count_stays": 1.0}
    usual = answers(AloneNoise(**certain), 1)
    tried = []
    for sigma, drift, drift_s, every in GRID:
        noise = AloneNoise(sigma_m=sigma, drift_sigma_m=drift, drift_s=drift_s, **certain)
        tried.append(np.array([a.right for a in answers(noise, every)]))
    lane = usual[0].lane
    chosen = np.zeros_like(tried[0])
    for block in np.array_split(np.arange(len(lane)), N_BLOCKS):
        others = np.setdiff1d(np.arange(len(lane)), block)
        best = max(tried, key=lambda right: right[:, others].mean())
        chosen[:, block] = best[:, block]
    nearest = np.mean([a.nearest for a in usual], axis=0)
    rows = {
        "always the most frequent lane": (lane == np.bincount(lane).argmax()).astype(float),
        "the lane nearest to the last offset": nearest,
        "filter with drift": np.mean([a.right for a in usual], axis=0),
        "filter, constants chosen without the fifth that is scored": chosen.mean(axis=0),
        "filter, the best of all constants (in-sample)": max(tried, key=np.mean).mean(axis=0),
    }
    yield f"| {len(lane)} changes near Rotterdam | right | 95 % | less nearest | 95 % |"
    yield "|---|---:|---:|---:|---:|"
    resampled = np.random.default_rng(0).integers(0, len(lane), (2000, len(lane)))
    for name, right in rows.items():
        cells = []
        for values in (right, right - nearest):
            low, high = np.quantile(values[resampled].mean(axis=1), [0.025, 0.975])
            cells += [f"{values.mean():.2f}", f"{low:.2f} to {high:.2f}"]
        yield f"| {name} | {' | '.join(cells)} |"
