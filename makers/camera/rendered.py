"""The four variants of the detector on rendered motorways, where everything is known.

Two drives of 3,000 frames with lane changes and bursts of failures, like the A4 (4 lanes) and the
A2 (3 lanes). Neither detectors nor graphs were tuned on rendered pictures: detectors with their
defaults, graphs with generic parameters (`SENSOR_FAILURE`) or none from labels (zero-label). The
detectors are given the camera at rest, not its pitch in a frame.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import yaml
from tqdm import tqdm

from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.results import Result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import FloatArray, LineLog
from egolane_pgm.views.tables import markdown
from egolane_pgm.vision import video
from egolane_pgm.vision.detectors import FrameLines, as_log
from egolane_pgm.vision.detectors.runner import find_detector, start
from egolane_pgm.vision.rendering.render import FrameTruth, render_frame
from egolane_pgm.vision.rendering.scene import FAILURES, Scene, make_scene

FRAMES = 3000
#: The first seeds whose drives spend 15 % of the time in every lane.
SEEDS = {"a4": 4, "a2": 1}
#: Bursts of failures: mean seconds between them and of one.
BURSTS = {"ok_s": 15.0, "bad_s": 5.0}
DETECTORS = ("ml", "sl", "mc", "sc")

#: Frames of a drive with one kind of failure; in so many of ten seconds it is there.
ABLATION_FRAMES, ABLATION_BAD_S = 600, 8.0

#: The frame of the A4-like drive that is drawn.
DRAWN_FRAME = 325

#: As in experiments/quickstart.yaml.
SENSOR_FAILURE = {
    "sigma1": 0.35,
    "sigma2": 0.5,
    "p1": 0.95,
    "p2": 0.95,
    "p3": 0.7,
    "p4": 0.7,
    "bonus_value": 3,
}

#: A true line counts as visible where so much of its marking between 6 and 25 m ahead can be seen,
#: and it is looked for so far to the side; a detected line is it when so near.
VISIBLE, SIDE_M, NEAR_M = 0.5, 8.0, 1.0


@dataclass(frozen=True)
class Followed:
    """What a detector made of a drive. log: its lines. ms: processor time per frame, median."""

    log: LineLog
    ms: float


@dataclass(frozen=True)
class Seen:
    """A drive and what was made of it. offset_m, visible (T, L): the true lines."""

    scene: Scene
    offset_m: FloatArray
    visible: FloatArray
    render_ms: float
    detectors: Mapping[str, Followed]


def follow(
    scene: Scene, names: Sequence[str], given: Mapping[str, Mapping[str, Any]] | None = None
) -> Seen:
    """Render a drive frame by frame, each detector looking at every frame.

    given: by detector, the parameters that are not its defaults
    """
    given = given or {}
    found = {
        name: find_detector(name, given.get(name, {}), Path.cwd(), "rendered") for name in names
    }
    steps = {name: start(detector, scene.camera) for name, detector in found.items()}
    lines: dict[str, list[tuple[int, FrameLines]]] = {name: [] for name in names}
    spent: dict[str, list[float]] = {name: [] for name in (*names, "render")}
    truths: list[FrameTruth] = []
    for k in tqdm(range(len(scene)), unit="frame", disable=None):
        clock = time.process_time()
        frame: Any = render_frame(scene, k)
        truths.append(frame.truth)
        spent["render"].append(time.process_time() - clock)
        for name, step in steps.items():
            clock = time.process_time()
            lines[name].append((k, step(frame)))
            spent[name].append(time.process_time() - clock)
    per_frame = {name: 1000 * float(np.median(seconds)) for name, seconds in spent.items()}
    return Seen(
        scene,
        np.stack([truth.offset_m for truth in truths]),
        np.stack([truth.visible for truth in truths]),
        per_frame["render"],
        {
            name: Followed(as_log(lines[name], scene.road.frame_rate, name), per_frame[name])
            for name in names
        },
    )


@dataclass(frozen=True)
class Lines:
    """How well lines were found. error_m: median and 90 % quantile of the offsets' errors, of
    visible lines that were found; recall: share of visible lines found (valid); false_share: share
    of the valid lines that are near no line of the road; dashed_right: found visible lines whose
    continuous flag is right."""

    error_m: float
    error_90_m: float
    recall: float
    false_share: float
    flag_right: float


def score_lines(seen: Seen, log: LineLog) -> Lines:
    """The valid lines of a log against the true ones, each true line with the nearest."""
    wanted = (seen.visible >= VISIBLE) & (np.abs(seen.offset_m) <= SIDE_M)
    offset = np.where(log.is_valid, log.offset_m, np.inf)
    if not offset.shape[1]:
        return Lines(np.nan, np.nan, 0.0, np.nan, np.nan)
    away = np.abs(offset[:, None, :] - seen.offset_m[:, :, None])
    nearest = away.min(axis=2)
    which = away.argmin(axis=2)
    flag = np.take_along_axis(log.is_continuous, which, axis=1)
    hit = wanted & (nearest < NEAR_M)
    error = nearest[hit]
    valid = log.is_valid & (np.abs(log.offset_m) <= SIDE_M)
    is_false = away.min(axis=1) >= NEAR_M
    return Lines(
        float(np.median(error)) if error.size else np.nan,
        float(np.quantile(error, 0.9)) if error.size else np.nan,
        float(hit.sum() / max(wanted.sum(), 1)),
        float(is_false[valid].mean()) if valid.any() else np.nan,
        float((flag == seen.scene.lines.is_continuous)[hit].mean()) if hit.any() else np.nan,
    )


def lane_belief(seen: Seen, log: LineLog, graph: str) -> Result:
    """The lines through evidence and a graph: the paper's `sensor_failure` with counting, or
    `position_in_lane` with line geometry."""
    road = seen.scene.road
    is_paper = graph == "sensor_failure"
    width = float(seen.scene.lines.d_m[1])
    content = {
        "name": "rendered",
        "recording": {"path": "lines.parquet", "frame_rate": road.frame_rate},
        "ground_truth": {"path": "truth.txt"},
        "n_lanes": road.n_lanes,
        "evidence": "counting" if is_paper else "line_geometry",
        "graph": graph,
        "filter": "assumed_density" if is_paper else "exact",
        "tuned_on": "not_tuned",
        "parameters": {**SENSOR_FAILURE, "lane_width_m": width} if is_paper else {},
    }
    with TemporaryDirectory() as place:
        folder = Path(place)
        write_table(folder / "lines.parquet", log)
        write_ground_truth(folder / "truth.txt", road.truth)
        (folder / "e.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        return run_experiment(folder / "e.yaml")


def _share(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "-"


def _four(scores: Mapping[str, Any]) -> list[str]:
    return [_share(scores[key]) for key in ("precision", "recall", "f1", "accuracy")]


def lane_table(seen: Seen) -> list[str]:
    """The paper's kind of table: detector only and models, per variant."""
    rows = []
    for name, followed in seen.detectors.items():
        paper = lane_belief(seen, followed.log, "sensor_failure")
        zero = lane_belief(seen, followed.log, "position_in_lane")
        rows.append([f"{name.upper()}, detector only", *_four(paper.scores["detector"])])
        rows.append([f"{name.upper()}, model of the paper", *_four(paper.scores["model"])])
        rows.append([f"{name.upper()}, zero-label model", *_four(zero.scores["model"])])
    return markdown(["", "precision", "recall", "F1", "accuracy"], rows).splitlines()


def line_table(seen: Seen) -> list[str]:
    """How well the lines themselves were found, per variant."""
    rows = []
    for name, followed in seen.detectors.items():
        lines = score_lines(seen, followed.log)
        rows.append(
            [
                name.upper(),
                f"{lines.error_m:.3f} m",
                f"{lines.error_90_m:.3f} m",
                _share(lines.recall),
                _share(lines.false_share),
                _share(lines.flag_right),
                f"{followed.ms:.1f} ms",
            ]
        )
    header = ["", "offset error, median", "90 %", "recall", "false", "flag right", "CPU per frame"]
    return markdown(header, rows).splitlines()


def failing_alone(preset: str, kinds: Sequence[str], names: Sequence[str]) -> Seen:
    """A drive on which only these kinds of failure occur, in bursts that fill most of it."""
    settings: dict[str, Any] = {kind: 0.0 for kind in FAILURES if kind not in kinds}
    return follow(
        make_scene(
            preset,
            SEEDS[preset],
            ABLATION_FRAMES,
            ok_s=10.0 - ABLATION_BAD_S,
            bad_s=ABLATION_BAD_S,
            **settings,
        ),
        names,
    )


def failure_table(preset: str, name: str) -> list[str]:
    """What each kind of failure costs, alone, one detector."""
    rows = []
    for kind in ("none", *FAILURES, "all"):
        kinds = FAILURES if kind == "all" else (kind,)
        seen = failing_alone(preset, kinds, [name])
        log = seen.detectors[name].log
        lines = score_lines(seen, log)
        near = np.abs(seen.offset_m) <= SIDE_M
        paper = lane_belief(seen, log, "sensor_failure")
        zero = lane_belief(seen, log, "position_in_lane")
        everywhere = float(found_share(seen, log))
        rows.append(
            [
                kind,
                _share(float(seen.visible[near].mean())),
                _share(everywhere),
                f"{lines.error_m:.3f} m",
                _share(lines.false_share),
                _share(paper.scores["detector"]["accuracy"]),
                _share(paper.scores["model"]["accuracy"]),
                _share(zero.scores["model"]["accuracy"]),
            ]
        )
    header = [
        "only this failure",
        "visible",
        "lines found",
        "offset error, median",
        "false",
        "detector only",
        "model of the paper",
        "zero-label model",
    ]
    return markdown(header, rows).splitlines()


def found_share(seen: Seen, log: LineLog) -> float:
    """The share of all lines within SIDE_M, visible or not, that a valid line is near to."""
    everything = Seen(
        seen.scene, seen.offset_m, np.ones_like(seen.visible), seen.render_ms, seen.detectors
    )
    return score_lines(everything, log).recall


def draw(folder: Path) -> None:
    """One frame with all that the detector and the model say of it: frame.png."""
    scene = make_scene("a4", SEEDS["a4"], FRAMES, **BURSTS)
    step = start(find_detector("mc", {}, Path.cwd(), "rendered"), scene.camera)
    lines = []
    for k in range(DRAWN_FRAME + 1):
        frame: Any = render_frame(scene, k)
        lines.append((k, step(frame)))
    log = as_log(lines, scene.road.frame_rate, "mc")
    run = lane_belief(Seen(scene, np.zeros(0), np.zeros(0), 0.0, {}), log, "sensor_failure")
    belief = run.beliefs.lane
    told = video.Scene(
        DRAWN_FRAME,
        DRAWN_FRAME / scene.road.frame_rate,
        lines[-1][1],
        belief[-1],
        int(assigned_lane(belief)[-1]),
        frame.truth.lane,
        frame.truth.is_crossing,
    )
    picture = video.draw_frame(video.layout(scene.camera), frame.image, told)
    smaller = cv2.resize(picture, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(folder / "frame.png"), smaller)


def drive(preset: str, names: Sequence[str], frames: int = FRAMES) -> Seen:
    """The drive of a preset, seen by some detectors."""
    is_stereo = any(name.startswith("s") for name in names)
    scene = make_scene(preset, SEEDS[preset], frames, stereo=is_stereo, **BURSTS)
    return follow(scene, names)


def report(seen: Seen, preset: str) -> list[str]:
    """The tables of a drive."""
    road = seen.scene.road
    changes = int((np.diff(road.lane) != 0).sum())
    near = (np.abs(seen.offset_m) <= SIDE_M) & (seen.visible >= VISIBLE)
    return [
        f"### Like the {preset.upper()}: {road.n_lanes} lanes",
        "",
        f"{len(road)} frames, {changes} lane changes, in a burst of failures in"
        f" {seen.scene.is_failing.mean():.0%} of them; {near.sum() / len(road):.1f} visible lines"
        f" per frame; rendered in {seen.render_ms:.0f} ms of CPU time per frame.",
        "",
        *lane_table(seen),
        "",
        *line_table(seen),
        "",
    ]


def measure() -> list[str]:
    """The tables as Markdown lines."""
    text = ["## Rendered motorways", "", *_EXPLAINED]
    for preset in SEEDS:
        text += report(drive(preset, DETECTORS), preset)
    text += ["### What each failure costs", "", *_ALONE, *failure_table("a4", "ml")]
    return text


_EXPLAINED = [
    "No parameter was chosen on rendered pictures: the detectors have their defaults, the model of",
    "the paper (`sensor_failure` with counting) the generic parameters of",
    "`experiments/quickstart.yaml` and the road's lane width, the zero-label model",
    "(`position_in_lane`, line geometry) nothing but n. Precision, recall and F1 are means over",
    f"the lanes, crossing frames left out. Lines: visible are those within {SIDE_M:g} m with at",
    f"least {VISIBLE:.0%} of their marking between 6 and 25 m ahead neither worn, hidden nor in",
    f"shadow; found: a valid line within {NEAR_M:g} m; false: valid lines near no line of the"
    " road.",
    "",
]

_ALONE = [
    f"ML on {ABLATION_FRAMES} frames of the same A4-like road, one kind of failure at a time, in",
    f"bursts of {ABLATION_BAD_S:g} s on the average with {10 - ABLATION_BAD_S:g} s in between."
    " Visible: share of the",
    f"markings within {SIDE_M:g} m; lines found: share of the lines within {SIDE_M:g} m, visible or"
    " not; accuracy of",
    "the lane on the right.",
    "",
]
