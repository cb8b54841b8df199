"""How many lanes the vehicle has been in, told from how the lines move.

The place inside the lane and the motion of the lines, without any evidence of which lane it is, are
filtered on roads of n and of n + 1 lanes. If the vehicle has crossed n lines to one side, a road of
n lanes has no place for it, and the log evidence of n + 1 lanes is far larger. If it has not, both
explain the drive alike: unused lanes cost nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import make_evidence
from egolane_pgm.types import Evidence, FloatArray
from tests.beyond_figures.strangers import zero_label
from tests.kits.strangers import STRANGERS, Drive, paper_drive

#: Natural log odds from which on a lane more counts as seen.
SURE = 10.0


def places_in_lane(drive: Drive, n_lanes: int) -> tuple[FloatArray, Evidence]:
    """The likelihood of each place inside the lane, (T, cells), from the evidence of a drive of
    which n lanes were told; and that evidence."""
    model = zero_label(n_lanes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        evidence = make_evidence(model, drive.log).filtered
    (likelihood,) = evidence.likelihoods.values()
    # A failing sensor tells the place inside the lane only, so every lane has the same.
    cells = likelihood.shape[1] // n_lanes
    places = likelihood[:, :cells, 1]
    return places / places.max(axis=1, keepdims=True), evidence


def log_evidence(places: FloatArray, evidence: Evidence, n_lanes: int) -> float:
    """The log evidence of the places in the lane and the lines' motion on a road of n lanes."""
    ((key, like),) = evidence.likelihoods.items()
    tiled = np.repeat(np.tile(places, n_lanes)[..., None], like.shape[2], axis=2)
    of_road = Evidence({key: tiled}, evidence.inputs)
    beliefs = filter_beliefs(zero_label(n_lanes).compiled, of_road, "exact")
    return float(beliefs.log_evidence.sum())


def odds_of_more(drive: Drive, n_lanes: int) -> float:
    """Log odds of n + 1 lanes against n, which were told."""
    places, evidence = places_in_lane(drive, n_lanes)
    told, more = (log_evidence(places, evidence, n) for n in (n_lanes, n_lanes + 1))
    return more - told


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """The odds on the ten recordings and their transformations, told n or n - 1 lanes."""
    yield "Log odds of a lane more than was told: the largest if the right number was told, the"
    yield f"smallest if one too few was; and how often they are {SURE:g} or more."
    yield ""
    yield "| what is done to the recording | right number told | one too few told |"
    yield "|---|---|---|"
    for name, change in STRANGERS.items():
        if only not in name:
            continue
        drives = [drive for run in runs for drive in change(paper_drive(run))]
        right = np.array([odds_of_more(drive, drive.n_lanes) for drive in drives])
        few = np.array([odds_of_more(drive, drive.n_lanes - 1) for drive in drives])
        yield (
            f"| {name} | {right.max():.1f}, {(right >= SURE).sum()} of {len(right)} |"
            f" {few.min():.1f}, {(few >= SURE).sum()} of {len(few)} |"
        )
