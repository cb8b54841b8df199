"""How many lanes the vehicle has been in, told from how the lines move.

The place inside the lane and the motion of the lines, without any evidence of which lane it is, are
filtered on roads of n and of n + 1 lanes. If the vehicle has crossed n lines to one side, a road of
n lanes has no place for it, and the log evidence of n + 1 lanes is far larger. If it has not, both
explain the drive alike: unused lanes cost nothing. That there are fewer lanes than told only the
lines themselves can say (`egolane_pgm.lane_count`).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence

import numpy as np

from egolane_pgm.experiment import load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.lane_count import WORTH_A_WORD, log_evidence_by_lanes
from egolane_pgm.loading import Recorded
from egolane_pgm.model import make_evidence
from egolane_pgm.paper import experiments_folder
from egolane_pgm.types import Evidence, FloatArray
from tests.beyond_figures.strangers import zero_label
from tests.kits.strangers import STRANGERS, Drive, paper_drive

#: The strangers that are tried here.
TRIED = (
    "as recorded",
    "like run 5",
    "like run 5, scale off by 15 % for 20 s",
    "offsets x 0.5",
    "offsets alone, of valid lines",
    "nearest 2 lines",
    "60 % of lines missing",
    "every 5th frame, ids jump",
    "a line of clutter, for 2 s each",
    "noise of .3 m",
    "camera .6 m off",
    "double lines, 20 cm apart",
    "a line .9 lanes right of the road",
    "blind for 2 s, 30 % of the time",
    "mirrored",
    "half of the middle lines missing, for 5 s each",
    "stands still for ten minutes",
)

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


def verdict_of_lines(drive: Drive, n_lanes: int) -> int:
    """What `lane_count` says: 1 if the lines fit a lane more than told, -1 if one less, else 0."""
    experiment = load_experiment(
        experiments_folder() / "zero_label.yaml",
        {"n_lanes": n_lanes, "parameters.lane_width_m": "causal"},
    )
    recorded = Recorded(drive.log, None, np.zeros(0, dtype=np.int64), (), ())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = log_evidence_by_lanes(experiment, recorded)
    best = max(found, key=found.__getitem__)
    return best - n_lanes if found[best] - found[n_lanes] >= WORTH_A_WORD else 0


def verdict_of_motion(drive: Drive, n_lanes: int, of_lines: int) -> int:
    """The same, but that there are more lanes is said only if the vehicle was in them, and that
    there are fewer only if it was not. of_lines: `verdict_of_lines`."""
    if odds_of_more(drive, n_lanes) >= SURE:
        return 1
    if of_lines < 0 and odds_of_more(drive, n_lanes - 1) < SURE / 2:
        return -1
    return 0


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """How often each verdict is given if n, n - 1 and n + 1 lanes are told."""
    yield "How many drives are said to fit another number of lanes better: by their lines alone"
    yield "(`lane_count`), by lines and motion together. In brackets: said in the wrong direction."
    yield ""
    yield "| | drives | right number told | one too few told | one too many told |"
    yield "|---|---|---|---|---|"
    for name in TRIED:
        if only not in name:
            continue
        drives = [drive for run in runs for drive in STRANGERS[name](paper_drive(run))]
        cells = []
        for told in (0, -1, 1):
            given = [(drive, drive.n_lanes + told) for drive in drives]
            lines = [verdict_of_lines(drive, n) for drive, n in given]
            both = [verdict_of_motion(*of, line) for of, line in zip(given, lines, strict=True)]
            cells.append(", ".join(_counted(verdicts, told) for verdicts in (lines, both)))
        yield f"| {name} | {len(drives)} | {' | '.join(cells)} |"


def _counted(verdicts: Sequence[int], told: int) -> str:
    if told == 0:
        return str(sum(verdict != 0 for verdict in verdicts))
    right, wrong = (sum(verdict == k for verdict in verdicts) for k in (-told, told))
    return f"{right} ({wrong})"
