"""How right the beliefs of the model without labels are, by how sure they are, for each kind of
detector."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.experiment import Experiment, experiments_folder, load_experiment
from egolane_pgm.scoring.probabilistic import N_BINS, calibration_curve
from egolane_pgm.tools.files import temporary_folder
from egolane_pgm.tools.jobs import in_order
from egolane_pgm.types import FloatArray
from egolane_pgm.views.answers import FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.style import axes_at, new_figure, write_figure
from makers.benchmark.board import run_on, score_recording
from makers.benchmark.tracks import Recording, make_tracks, read_tracks

#: A point of fewer frames is hollow, one of fewer than the second is left out.
FEW_FRAMES, LEAST_FRAMES = 1000, 30

#: The kinds of detectors, as they are called at the end of a donor's name, and the tracks of drives
#: with lines of their own.
KINDS = {
    "ml": "ml (runs 1, 6)",
    "sl": "sl (runs 2, 7)",
    "mc": "mc (runs 3, 8)",
    "sc": "sc (runs 4, 9)",
    "italy_mld": "MLD, Italy (run 5)",
    "spain_mld": "MLD, Spain (run 10)",
    "two_lines": "own two lines only",
    "two_lines, start told": "the same, 10 s of all lines first",
}

SUMS = ("sure", "scored", "sure_right", "losses", "frames")

TEXT = """\
# How sure, and how right, by kind of detector

Made by `python -m makers.beyond calibration --out results/beyond`. The model without labels
(`zero_label.yaml`, causal) on the paper's ten recordings and the public part of the benchmark
(Rotterdam as `make benchmark` makes it), all drives with the lines of one kind of detector
together. *Sure* is a belief over .95; *believed* is
the mean of the largest probability; *calibration error* is the mean distance between the two over
15 bins (ECE); log-loss is of all frames, those of lane changes too. Development scores: the
constants were chosen with these drives in sight.

![Share right against the belief, by kind of detector](calibration.png)

*Above: the share of right frames against the largest probability; on the grey line a belief is as
right as it says, above it unsure. Points of fewer than 1,000 frames are hollow. Below: how many
frames have such a belief. Frames of one drive are alike, so a point is worth less than its frames.*

| detector | drives | frames | believed | right | calibration error | sure | right where sure \
| log-loss |
|---|--:|--:|--:|--:|--:|--:|--:|--:|"""


def kind_of(recording: Recording) -> str:
    """Which of KINDS."""
    if not recording.donor:
        return recording.track
    return recording.donor if recording.donor.endswith("mld") else recording.donor.split("_")[1]


def recordings() -> list[Recording]:
    """The paper's recordings and the public part of the benchmark."""
    bench = Path(os.environ["EGOLANE_DATA"]) / "bench"
    with temporary_folder() as made:
        make_tracks(made)
        folders = [made / "paper", made / "rotterdam", bench / "motion", bench / "two_lines"]
        return read_tracks(folders)


def scores(experiment: Experiment, recording: Recording) -> tuple[str, dict[str, Any]]:
    """The kind of a recording, the sums of its scores, and per bin of the largest probability the
    frames, the sum of it, and the right ones."""
    belief, truth = run_on(recording, experiment).marginals["Lane"], recording.truth
    curve = calibration_curve(belief, truth.lane, truth.is_crossing)
    bins = [np.nan_to_num(each) * curve.count for each in (curve.confidence, curve.accuracy)]
    sums = score_recording(recording, belief)
    return kind_of(recording), {**sums, "reliability": [curve.count, *bins]}


@cache
def found(overrides: tuple[str, ...]) -> Mapping[str, list[dict[str, Any]]]:
    """The sums of the drives of each kind."""
    experiment = load_experiment(experiments_folder() / "zero_label.yaml", overrides)
    kinds: dict[str, list[dict[str, Any]]] = {kind: [] for kind in KINDS}
    for kind, sums in in_order(partial(scores, experiment), recordings(), 1):
        kinds[kind].append(sums)
    return kinds


def reliability(drives: Sequence[Mapping[str, Any]]) -> FloatArray:
    """(3, bins): frames, the sum of their largest probability, and the right ones."""
    return np.sum([drive["reliability"] for drive in drives], axis=0)


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """The table, a line at a time."""
    yield TEXT
    for kind, drives in found(tuple(overrides)).items():
        count, believed, right = reliability(drives)
        n = {key: sum(drive[key] for drive in drives) for key in SUMS}
        values = (
            believed.sum() / count.sum(),
            right.sum() / count.sum(),
            np.abs(believed - right).sum() / count.sum(),
            n["sure"] / n["scored"],
        )
        cells = [KINDS[kind], str(len(drives)), f"{count.sum():.0f}"]
        cells += [f"{value:.3f}" for value in values]
        cells += [f"{n['sure_right'] / n['sure']:.4f}", f"{n['losses'] / n['frames']:.3f}"]
        yield f"| {' | '.join(cells)} |"


def draw(folder: Path) -> None:
    """Draw calibration.png."""
    write_figure(lambda: figure(found(())), folder / "calibration.png")


def figure(kinds: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    """A panel for each kind: the share of right frames against the belief, and how many frames
    there are of each belief."""
    across, side, low = 4, 2.0, 0.55
    wide, tall = side + 0.35, side + low + 0.85
    result = new_figure(0.35 + across * wide + 0.15, 2 * tall + 0.12)
    edges = np.linspace(0, 1, N_BINS + 1)
    for k, (kind, drives) in enumerate(kinds.items()):
        left, top = 0.55 + k % across * wide, 0.4 + k // across * tall
        upper, lower = (
            axes_at(result, left, top, side, side),
            axes_at(result, left, top + side + 0.08, side, low),
        )
        count, believed, right = reliability(drives)
        upper.plot([0, 1], [0, 1], color=FAINT, linewidth=1)
        some = count >= LEAST_FRAMES
        share, answer = right[some] / count[some], believed[some] / count[some]
        upper.plot(answer, share, color=MODEL_COLOUR, linewidth=1.3)
        for is_few, face in ((False, MODEL_COLOUR), (True, "white")):
            those = (count[some] < FEW_FRAMES) == is_few
            upper.plot(
                answer[those], share[those], "o", color=MODEL_COLOUR, markersize=4.5,
                markerfacecolor=face,
            )  # fmt: skip
        lower.bar(edges[:-1], count, 0.9 / N_BINS, align="edge", color=MODEL_COLOUR)
        lower.set_yscale("log")
        lower.set_ylim(1, 2e5)
        lower.set_yticks([1, 1e2, 1e4])
        upper.set_ylim(-0.02, 1.02)
        upper.set_title(KINDS[kind], fontsize=9, color=INK)
        upper.text(0.97, 0.04, f"{len(drives)} drives", fontsize=7.5, ha="right", color=INK)
        upper.tick_params(labelbottom=False)
        for axes in (upper, lower):
            axes.set_xlim(0.15, 1.02)
            axes.tick_params(labelsize=7, labelleft=k % across == 0)
            axes.grid(color="#ececec", linewidth=0.6)
            axes.set_axisbelow(True)
        if k % across == 0:
            upper.set_ylabel("share right", fontsize=8)
            lower.set_ylabel("frames", fontsize=8)
    result.text(0.5, 0.01, "largest probability over the lanes", fontsize=8, ha="center")
    return result
