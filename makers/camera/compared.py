"""All detectors on one rendered drive through the paper's graph: what its tables of ten runs show,
in kind.

A road like the A4 with four lanes, in half of the time in a burst of failures (vehicles, wear,
shadow, noise), so that a detector alone fails as often as the paper's did. The seed is the first
whose drive spends 15 % of the time in every lane. Detectors have their defaults, the graph the
generic parameters of `rendered`, the same for all: no parameter was chosen on this drive. The
network is a tiny one of the tests, trained on twelve frames of another rendered drive; it stands
for that detector's way, not for a network of today.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from egolane_pgm.paper import load_published
from egolane_pgm.plugins import plugin_names
from egolane_pgm.views.answers import DETECTOR_COLOUR, INK, MODEL_COLOUR
from egolane_pgm.views.tables import markdown
from egolane_pgm.vision.rendering.scene import make_scene
from makers.camera import rendered
from makers.camera.rendered import Lines, Seen, score_lines

FRAMES, SEED = 900, 3
BURSTS = {"ok_s": 6.0, "bad_s": 6.0}

#: The detectors that need no file of the user, in the order of the table; those that are not there
#: are left out.
ORDER = ("ml", "sl", "mc", "sc", "mld", "aly")

#: The paper's runs on the A4.
PAPER_RUNS = range(1, 6)

#: The seed of the drive on which the network is trained.
_TRAINED_ON = 100

_EXPLAINED = (
    "Accuracy and F1 (mean over the lanes) of the lane, crossing frames left out, as the paper has"
    " them: of the detector alone and of the paper's graph on its lines, with the same generic"
    " parameters for all. The paper's own figures are beside them: runs 1 to 5 on the A4 in Italy,"
    " each tuned on the frames that it is scored on. Offset error: median over the visible lines"
    f" that were found (a valid line within {rendered.NEAR_M:g} m); found: share of the visible"
    " ones; false: share of the valid lines that are near no line of the road. CPU: median"
    " processor time per picture (pairs for sl and sc). mld tells no continuous lines from dashed"
    " ones, so that alone it counts no lanes, here as in the paper. network is a tiny one that the"
    " tests train on twelve rendered pictures: it shows that the way works, not what a network of"
    " today reaches."
)


@dataclass(frozen=True)
class Row:
    """A detector on the drive. detector, model: accuracy and mean F1 over the lanes, of the
    detector alone and of the paper's graph; lines: its lines against the true ones; ms: processor
    time per picture."""

    name: str
    detector: tuple[float, float]
    model: tuple[float, float]
    lines: Lines
    ms: float

    @property
    def gain(self) -> float:
        """By how much the graph is right more often than the detector alone."""
        return self.model[0] - self.detector[0]


def seen_by(names: Sequence[str], frames: int = FRAMES, network: Path | None = None) -> Seen:
    """The drive, seen by some detectors. network: the YAML of one for the detector `network`."""
    cv2.setNumThreads(1)
    is_stereo = any(name in ("sl", "sc") for name in names)
    scene = make_scene("a4", SEED, frames, stereo=is_stereo, **BURSTS)
    return rendered.follow(scene, names, {"network": {"network": str(network)}} if network else {})


def rows_of(seen: Seen) -> tuple[Row, ...]:
    """The rows of the table, in the order of the detectors."""
    rows = []
    for name, followed in seen.detectors.items():
        scores = rendered.lane_belief(seen, followed.log, "sensor_failure").scores
        alone, model = ((scores[k]["accuracy"], scores[k]["f1"]) for k in ("detector", "model"))
        rows.append(Row(name, alone, model, score_lines(seen, followed.log), followed.ms))
    return tuple(rows)


def paper_accuracy() -> dict[str, tuple[float, float]]:
    """By detector, what the paper prints of its runs on the A4: of the detector alone, of the
    model."""
    published = load_published()
    return {
        published[k]["detector"].lower(): (
            published[k]["detector_only"]["metrics"]["accuracy"],
            published[k]["model"]["metrics"]["accuracy"],
        )
        for k in PAPER_RUNS
    }


def table(rows: Sequence[Row]) -> list[str]:
    """The Markdown table, line by line."""
    paper, cells = paper_accuracy(), []
    for row in rows:
        theirs = paper.get(row.name)
        cells.append(
            [
                row.name,
                *(f"{value:.3f}" for value in (row.detector[0], row.model[0])),
                *(f"{value:.3f}" for value in (row.detector[1], row.model[1])),
                "-" if theirs is None else f"{theirs[0]:.2f}, {theirs[1]:.2f}",
                f"{row.lines.error_m:.3f} m",
                f"{row.lines.recall:.3f}",
                f"{row.lines.false_share:.3f}",
                f"{row.ms:.0f} ms",
            ]
        )
    header = ["", "accuracy, detector only", "model", "F1, detector only", "model"]
    header += ["paper's accuracies", "offset error", "found", "false", "CPU"]
    return markdown(header, cells).splitlines()


def verdict(rows: Sequence[Row]) -> str:
    """Two sentences: what agrees in kind with the paper's tables, and what does not."""
    better = [row.name for row in rows if row.gain > 0]
    if len(better) == len(rows):
        agrees = "the model is right more often than the detector alone for every detector"
    else:
        worse = ", ".join(row.name for row in rows if row.gain <= 0)
        agrees = (
            f"the model is right more often than the detector alone for {len(better)} of"
            f" {len(rows)} detectors (not for {worse})"
        )
    paper = paper_accuracy()
    ours = [row for row in rows if row.name in paper]
    low, high = (pick(row.detector[0] for row in ours) for pick in (min, max))
    their_low, their_high = (pick(alone for alone, _ in paper.values()) for pick in (min, max))
    return (
        f"What agrees in kind: {agrees}, by {min(row.gain for row in rows):.2f} to"
        f" {max(row.gain for row in rows):.2f}. What does not: these pictures are easier, so that"
        f" the paper's detectors alone are right in {low:.2f} to {high:.2f} of frames where the"
        f" paper has {their_low:.2f} to {their_high:.2f}, and its parameters were tuned on the"
        " frames that they are scored on."
    )


@cache
def compared() -> tuple[Seen, tuple[Row, ...]]:
    """The drive, seen by every detector that is there."""
    names = [name for name in ORDER if name in plugin_names("detectors")]
    with TemporaryDirectory() as place:
        network = _network(Path(place))
        seen = seen_by([*names, "network"] if network else names, network=network)
    return seen, rows_of(seen)


def _network(folder: Path) -> Path | None:
    """The tiny network of the tests; None where ONNX, which trains it, is not installed."""
    if "network" not in plugin_names("detectors"):
        return None
    try:
        from tests.kits.tiny_network import write_trained

        return write_trained(folder, seed=_TRAINED_ON) / "lanes.yaml"
    except ImportError:
        return None


def measure() -> list[str]:
    """The table as Markdown."""
    seen, rows = compared()
    road = seen.scene.road
    changes = int((road.lane[1:] != road.lane[:-1]).sum())
    return [
        "# The detectors on one drive",
        "",
        f"{len(road)} rendered frames of a motorway with {road.n_lanes} lanes, {changes} lane"
        f" changes, in a burst of failures in {seen.scene.is_failing.mean():.0%} of them.",
        "",
        *table(rows),
        "",
        verdict(rows),
        "",
        _EXPLAINED,
        "",
        "![Accuracy of each detector alone and with the paper's graph, offset error and processor"
        " time](detectors.png)",
    ]


def draw(folder: Path) -> None:
    """The figure: detectors.png."""
    draw_rows(compared()[1], folder / "detectors.png")


def draw_rows(rows: Sequence[Row], path: Path) -> None:
    """A row for each detector: the accuracies, ours and the paper's; the offset error; the
    processor time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 1.2 + 0.5 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    lane, place, time = figure.subplots(1, 3, sharey=True, width_ratios=[2, 1, 1])
    paper = paper_accuracy()
    for k, row in enumerate(rows):
        pairs = [(k, (row.detector[0], row.model[0]), 7)]
        if row.name in paper:
            pairs.append((k + 0.28, paper[row.name], 4))
        for at, (alone, model), size in pairs:
            ours = size > 4
            lane.plot([alone, model], [at, at], "-", color=INK, linewidth=0.8, zorder=1)
            for value, mark, colour in ((alone, "s", DETECTOR_COLOUR), (model, "o", MODEL_COLOUR)):
                lane.plot(value, at, mark, mec=colour, mfc=colour if ours else "white", ms=size)
        for axes, value, text in (
            (place, 100 * row.lines.error_m, f"{100 * row.lines.error_m:.1f}"),
            (time, row.ms, f"{row.ms:.0f}"),
        ):
            axes.plot(value, k, "D", color=INK)
            axes.annotate(text, (value, k), (7, -3), textcoords="offset points", fontsize=8)
    lane.set_yticks(range(len(rows)), [row.name for row in rows])
    lane.set(xlim=(-0.02, 1.02), ylim=(len(rows) - 0.4, -0.6), xlabel="accuracy of the lane")
    place.set(xscale="log", xlabel="offset error, median, cm")
    time.set(xscale="log", xlabel="processor time per picture, ms")
    for axes in (place, time):
        axes.margins(x=0.3)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
    for axes in (lane, place, time):
        axes.grid(alpha=0.3)
    legend = (
        ("s", DETECTOR_COLOUR, DETECTOR_COLOUR, "detector only"),
        ("o", MODEL_COLOUR, MODEL_COLOUR, "with the paper's graph"),
        ("s", DETECTOR_COLOUR, "white", "the paper's own, detector only"),
        ("o", MODEL_COLOUR, "white", "and its model (A4, in-sample)"),
    )
    for mark, edge, face, label in legend:
        lane.plot([], [], mark, mec=edge, mfc=face, ms=7 if face == edge else 4, label=label)
    figure.legend(loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    figure.savefig(path, dpi=150, metadata={"Software": None})
