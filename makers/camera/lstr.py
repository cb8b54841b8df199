"""A real lane network, LSTR, and our detectors on the pictures of `tusimple`, `clips`, `carnd`.

LSTR was trained on TuSimple's training set, of which the stills and the clips are part: there it is
in-sample. The video is new to it and has a lower horizon: it is run on whole pictures, and on
pictures with the sky cut off (`cut_top`), with the horizon as high as in TuSimple's.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import yaml

from egolane_pgm.views.tables import markdown
from egolane_pgm.vision.camera.model import Camera, vanishing_point
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.camera.pictures import open_source, read_pictures
from egolane_pgm.vision.detectors import FrameLines, as_log
from egolane_pgm.vision.detectors.networks.description import READY, read_network
from egolane_pgm.vision.detectors.networks.finding import network_finder
from egolane_pgm.vision.detectors.runner import detect, find_detector
from egolane_pgm.vision.detectors.simple.fit import view_for
from makers.camera import carnd, clips, tusimple
from makers.camera._following import data_path, runs
from makers.camera._labels import label_picture, label_places, read_labels

FILE = "networks/lstr_360x640.onnx"
VIDEO_COLUMNS = ["", "both ego lines", "width", "left, right continuous"]
VIDEO_COLUMNS += ["the paper's graph", "zero labels"]

#: The detectors that are compared; on the videos the network also with the sky cut off.
NAMES = ("lstr", "ml", "mc")
CUT = "lstr, sky cut off"

#: The horizon in TuSimple's pictures, as a share of their height.
HORIZON = 236 / 720


def data_file() -> Path | None:
    """The ONNX, or None if it is absent."""
    return data_path(FILE)


def detector(name: str, **given: Any) -> Any:
    """A detector by its name here."""
    if name != "lstr":
        return find_detector(name, given, "lstr")
    onnx = data_file()
    assert onnx is not None
    return find_detector("network", {"network": str(onnx.parent / "lstr"), **given}, "lstr")


def look_at(labels: Path, which: slice) -> list[tusimple.Still]:
    """Lines and labels of some of the stills, single frames, as `tusimple.look_at`."""
    camera, found = tusimple.CAMERA, detector("lstr")
    parameters = found.parameters
    view = view_for(camera, parameters)
    find = network_finder(camera, read_network(parameters["network"]), parameters)
    stills = []
    for frame in read_labels(labels)[which]:
        seen = find(view, Picture(0, cv2.imread(str(label_picture(frame, labels)))), None)
        places = label_places(camera, frame, tusimple.AHEAD_M)
        stills.append(tusimple.Still(places, seen.shape @ tusimple.AHEAD, seen.score))
    return stills


def followed(
    name: str, camera: Camera, pictures: Iterable[Picture], **given: Any
) -> list[tuple[int, FrameLines]]:
    """The lines of a detector over a drive, by frame."""
    if name != CUT:
        return list(detect(detector(name, **given), camera, pictures))
    horizon = vanishing_point(camera)[1] / camera.height
    keys = yaml.safe_load((READY / "lstr.yaml").read_text())
    keys |= {"model": str(data_file()), "cut_top": float((horizon - HORIZON) / (1 - HORIZON))}
    with TemporaryDirectory() as folder:
        (Path(folder) / "cut.yaml").write_text(yaml.safe_dump(keys))
        cut = find_detector("network", {"network": str(Path(folder) / "cut.yaml")}, "cut")
        return list(detect(cut, camera, pictures))


@cache
def on_clips(folder: Path, name: str, beyond: str = clips.BEYOND[0]) -> np.ndarray:
    """(4,): labels found, labels, lines that are labelled, lines, of the last frames, tracked."""
    camera, total = tusimple.CAMERA, np.zeros(4)
    for frame in read_labels(folder / "labels.jsonl"):
        clip = Path(frame["raw_file"]).parent
        pictures = read_pictures(open_source(folder / str(clip).removeprefix("clips/")), camera)
        _, last = followed(name, camera, pictures, beyond_edge=beyond)[-1]
        places = last.shape[last.is_valid] @ tusimple.AHEAD
        label_m = label_places(camera, frame, tusimple.AHEAD_M)
        total += tusimple.Still(label_m, places, np.ones(len(places))).counts()
    return total


def _shares(counts: np.ndarray) -> list[str]:
    found, labels, right, lines = (int(each) for each in counts)
    return [f"{found} of {labels}", f"{found / labels:.0%}", f"{right / max(lines, 1):.0%}"]


def _still_rows(labels: Path) -> list[list[str]]:
    halves = slice(0, tusimple.HALF), slice(tusimple.HALF, None)
    rows = []
    for name in NAMES:
        cells = [name]
        for which in halves:
            curve = "line" if name == "ml" else "clothoid"
            stills = (
                look_at(labels, which)
                if name == "lstr"
                else tusimple.look_at(labels, which, curve=curve)
            )
            least = 0.0 if name == "lstr" else tusimple.least_score()
            recall, precision = tusimple.recall_precision(stills, least)
            error = np.median(tusimple.errors_m(stills, least))
            cells += [f"{recall:.1%}", f"{precision:.1%}", f"{error:.2f} m"]
        rows.append(cells)
    return rows


def _video_row(name: str, folder: Path) -> list[str]:
    camera = carnd.camera_of(folder)
    pictures = list(read_pictures(open_source(folder / "test_video.mp4"), camera))
    log = as_log(followed(name, camera, pictures), carnd.RATE)
    lane, first = carnd.ego_lane(log), round(carnd.FROM_S * carnd.RATE)
    both = np.isfinite(lane.width_m)
    width = lane.width_m[both]
    solid = [side[both].mean() for side in (lane.is_left_continuous, lane.is_right_continuous)]
    return [
        name,
        f"{both.sum()} of {len(log)}",
        f"{width.mean():.2f} m (sd {width.std():.2f})",
        f"{solid[0]:.0%}, {solid[1]:.0%}",
        runs(lane.lane[first:]),
        runs(lane.lane_zero[first:]),
    ]


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    labels, folders = tusimple.data_file(), (clips.data(), carnd.data())
    if data_file() is None or labels is None or None in folders:
        return [f"A real network: {FILE} or the pictures are absent (EGOLANE_DATA)."]
    of_clips, of_video = (folder for folder in folders if folder is not None)
    return [
        "### A real lane network and our detectors",
        "",
        "LSTR (`network=lstr`; its ONNX of 640 x 360) was trained on TuSimple's training set:"
        " stills and clips are part of that, so in-sample for it; the video is not. Its"
        f" horizon is lower than TuSimple's; in `{CUT}` it is as high (`cut_top`).",
        "",
        "Single stills, no tracking, as above; the first 55, then the last 55:",
        "",
        *markdown(
            ["", *2 * ["recall", "precision", "median error"]], _still_rows(labels)
        ).splitlines(),
        "",
        "Ten clips of a second, tracked, as above:",
        "",
        *markdown(
            ["", "found", "recall", "precision"],
            [
                *([name, *_shares(on_clips(of_clips, name))] for name in NAMES),
                ["lstr, none hidden", *_shares(on_clips(of_clips, "lstr", "keep"))],
            ],
        ).splitlines(),
        "",
        f"The video in the leftmost lane (out-of-sample), n = 4; lanes from {carnd.FROM_S} s on:",
        "",
        *markdown(
            VIDEO_COLUMNS,
            [_video_row(name, of_video) for name in (CUT, *NAMES)],
        ).splitlines(),
    ]
