"""How right the lane is behind a change of lanes, and elsewhere."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from egolane_pgm.drive import Recorded
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.maps import road_table
from egolane_pgm.maps.steps import LanesAlong
from egolane_pgm.model import Model, make_evidence
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.road import road_scores
from egolane_pgm.types import Evidence, FloatArray, IntArray
from makers.maps._drives import MAPS, data
from makers.maps._experiments import COUNTING, POSITIONS, prepared, simulated

#: Over each map, each mirrored map, and made-up ones.
N_DRIVES = 6


def measure() -> Iterator[str]:
    """Lines of a Markdown table."""
    yield "| | behind | elsewhere | elsewhere less behind, points |"
    yield "|---|---:|---:|---:|"
    real = [
        (f, m) for f in (data() / "maps" / f"{name}.osm" for name in MAPS) for m in (False, True)
    ]
    for title, places in (
        ("real maps and mirror images", real),
        ("made-up roads", [(None, False)]),
    ):
        found: dict[str, list[FloatArray]] = defaultdict(list)
        changes = 0
        for file, is_mirrored in places:
            for seed in range(N_DRIVES):
                with tempfile.TemporaryDirectory() as folder:
                    experiment = simulated(Path(folder), seed, file, is_mirrored)
                    for name, right, n in _contestants(experiment, Path(folder)):
                        found[name].append(right)
                        changes += n if name == "changing_lanes" else 0
        yield f"| {len(found['changing_lanes'])} drives, {title}, {changes} changes | | | |"
        for name, each in found.items():
            yield f"| {name} | {' | '.join(_with_intervals(np.array(each)))} |"
        pair = [np.array(found[n]) for n in ("position_in_changing_lanes", "changing_lanes")]
        gain = _intervals(partial(_gain, *pair), len(pair[0]))
        cells = " | ".join(f"{x:.1f} ({y:.1f} to {z:.1f})" for x, y, z in zip(*gain, strict=True))
        yield f"| position in lane less changing_lanes, points | {cells} | |"


def _contestants(experiment: Experiment, folder: Path) -> Iterator[tuple[str, FloatArray, int]]:
    """Name, right and scored frames behind changes and elsewhere (2, 2), and number of changes."""
    road = road_table.load(folder / "road.parquet")
    shift = np.where(np.isfinite(road.next_shift), 0.0, road.next_shift)
    kept = road_table.RoadTable(
        **{name: getattr(road, name) for name in road_table.COLUMNS if name != "next_shift"},
        next_shift=shift,
    )
    road_table.save(kept, folder / "kept.parquet")
    exact = {**COUNTING, "parameters.place_sigma_m": 0}
    for names, overrides in (
        (("changing_lanes", ""), COUNTING),
        (("a map that is taken for exact", "starting anew at each change"), exact),
        (("lanes keep their numbers", ""), {**exact, "road": "kept.parquet"}),
        (("position_in_changing_lanes", "the same, starting anew"), POSITIONS),
    ):
        model, recorded, road = prepared(load_experiment(experiment, overrides))
        evidence = make_evidence(model, recorded.log, "soft", road).filtered
        for name, cuts in zip(names, ((), road.changes), strict=True):
            if name:
                belief = _anew_at(model, evidence, cuts)
                yield name, _right(belief, recorded, road, experiment), len(road.changes)


def _anew_at(model: Model, evidence: Evidence, cuts: Sequence[int] | IntArray) -> FloatArray:
    """The belief over lanes, beginning anew at some frames."""
    ends = np.unique([0, *cuts, len(evidence)])
    parts = [evidence.take(slice(a, b)) for a, b in pairwise(ends)]
    return np.concatenate([filter_beliefs(model.compiled, e, "exact").lane for e in parts])


def _right(
    belief: FloatArray, recorded: Recorded, road: LanesAlong, experiment: Experiment
) -> FloatArray:
    assert recorded.truth is not None
    rows = recorded.scored
    scores = road_scores(
        assigned_lane(belief)[rows],
        recorded.truth,
        road.n_lanes[rows],
        road.changes,
        log_frames=rows,
        frame_rate=experiment.recording.frame_rate,
    )
    frames = np.array([scores[key]["frames"] for key in ("behind", "elsewhere")])
    accuracy = [scores[key]["accuracy"] or 0.0 for key in ("behind", "elsewhere")]
    return np.array([np.round(accuracy * frames), frames])


def _shares(counts: FloatArray) -> FloatArray:
    """The shares of right frames behind and elsewhere of D drives: counts (D, 2, 2), right frames
    and frames."""
    right, frames = counts.sum(axis=0)
    return np.asarray(right / frames)


def _gain(ours: FloatArray, theirs: FloatArray, drives: IntArray) -> FloatArray:
    """How many points more are right behind changes and elsewhere."""
    return np.asarray(100 * (_shares(ours[drives]) - _shares(theirs[drives])))


def _with_intervals(counts: FloatArray) -> list[str]:
    """The shares behind and elsewhere, and what is lost behind, points."""

    def shares(drives: IntArray) -> FloatArray:
        behind, elsewhere = _shares(counts[drives])
        return np.array([behind, elsewhere, 100 * (elsewhere - behind)])

    form = ("{:.3f}", "{:.3f}", "{:.1f}")
    rows = zip(form, *_intervals(shares, len(counts)), strict=True)
    return [f"{f.format(a)} ({f.format(b)} to {f.format(c)})" for f, a, b, c in rows]


def _intervals(statistic: Callable[[IntArray], FloatArray], n_drives: int) -> list[FloatArray]:
    """A statistic of some of the drives: of all of them, and its lower and upper end."""
    rng = np.random.default_rng(0)
    again = [statistic(rng.integers(n_drives, size=n_drives)) for _ in range(2000)]
    return [statistic(np.arange(n_drives)), *np.percentile(again, [2.5, 97.5], axis=0)]
