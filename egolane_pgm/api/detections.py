"""Detecting lines in pictures: `detect` and what it returns."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.api.given import keys_of, path_of
from egolane_pgm.camera.model import read_camera
from egolane_pgm.camera.pictures import camera_of_pictures, open_source, read_pictures
from egolane_pgm.detectors.runner import check_pair, collect, find_detector
from egolane_pgm.detectors.runner import detect as detect_lines
from egolane_pgm.recordings import write_lines, writer_of
from egolane_pgm.report import shown
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, LineLog

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

#: Extensions of recordings of lines that can be written.
TARGETS = (".parquet", ".csv", ".bag")


@dataclass(frozen=True, repr=False, eq=False)
class DetectResult:
    """The lines that a detector saw in pictures.

    - log: the lines of T frames.
    - source: the pictures. detector: its name.
    - frame_rate: of the video, frames per second; None where the pictures do not say it.
    - seconds: that it took.
    - stopped: what ended it early, a KeyboardInterrupt or an InputError; `detect` raises it, so
      that it is None there.

    >>> import egolane_pgm as ego
    >>> from egolane_pgm.simulation import simulate
    >>> log = simulate("quickstart", frames=100).log
    >>> found = ego.DetectResult(log, "drive.avi", "ml", 10.0, 2.0)
    >>> found
    DetectResult(100 frames, ids 0 to 99; 3.4 lines per frame, 3.1 of them valid; 50 frames/s)
    >>> list(found.to_pandas().columns)
    ['time_s', 'offset_m', 'is_valid', 'is_continuous', 'lri']
    """

    log: LineLog
    source: str
    detector: str
    frame_rate: float | None
    seconds: float
    stopped: KeyboardInterrupt | InputError | None = None

    def __repr__(self) -> str:
        return f"DetectResult({self.title()})"

    def title(self) -> str:
        """What was found, in one line."""
        log = self.log
        lines = np.isfinite(log.offset_m).sum(axis=1).mean()
        return (
            f"{len(log)} frames, ids {int(log.frame_id[0])} to {int(log.frame_id[-1])};"
            f" {lines:.1f} lines per frame, {log.is_valid.sum(axis=1).mean():.1f} of them valid;"
            f" {len(log) / max(self.seconds, 1e-9):.0f} frames/s"
        )

    def _repr_html_(self) -> str:
        log = self.log
        rows = [
            ["frames", str(len(log))],
            ["frame ids", f"{int(log.frame_id[0])} to {int(log.frame_id[-1])}"],
            ["lines per frame", f"{np.isfinite(log.offset_m).sum(axis=1).mean():.1f}"],
            ["of them valid", f"{log.is_valid.sum(axis=1).mean():.1f}"],
        ]
        return shown.html_table(f"{self.detector}: {self.source}", ["lines", ""], rows)

    def to_pandas(self) -> pd.DataFrame:
        """A row per line; the index is `frame_id` and `line`, from 1.

        Columns: `time_s`, `offset_m` (negative left), `is_valid`, `is_continuous`, `lri`. Frames
        without lines have no row.
        """
        import pandas as pd

        log = self.log
        frame, line = np.nonzero(np.isfinite(log.offset_m))
        columns = {
            "frame_id": log.frame_id[frame],
            "line": line + 1,
            "time_s": log.time_s[frame],
            **{
                name: getattr(log, name)[frame, line]
                for name in ("offset_m", "is_valid", "is_continuous", "lri")
            },
        }
        return pd.DataFrame(columns).set_index(["frame_id", "line"])

    def to_xarray(self) -> xr.Dataset:
        """`to_pandas` as a data set. Raises InputError where xarray is not installed."""
        return shown.as_dataset(self.to_pandas())

    def plot(self) -> Figure:
        """Draw the offsets of the lines over time."""
        from egolane_pgm.report.lines import lines_figure
        from egolane_pgm.report.style import inline_figure

        return inline_figure(lambda: lines_figure(self.log, f"{self.detector}: {self.source}"))

    def save(self, target: str | os.PathLike[str]) -> Path:
        """Write the lines as a recording that `run` takes.

        - target: a file, .parquet, .csv or .bag; or a folder for `lines.parquet`.

        Returns the file. Raises InputError where it cannot be written.
        """
        place = Path(target)
        if not place.suffix or place.is_dir():
            place = place / "lines.parquet"
        check_target(place)
        place.parent.mkdir(parents=True, exist_ok=True)
        write_lines(place, self.log)
        return place


def check_target(target: str | os.PathLike[str]) -> None:
    """Raise InputError for a file that lines cannot be written to. What writes them is loaded: it
    must not fail when they were found."""
    if Path(target).suffix.lower() not in TARGETS:
        raise InputError(f"--out {target}: lines are written as {', '.join(TARGETS)}")
    check_place(Path(target))
    writer_of(Path(target))


def detect(
    pictures: str | os.PathLike[str],
    *,
    camera: str | os.PathLike[str],
    detector: str = "ml",
    right: str | os.PathLike[str] | None = None,
    frames: tuple[int, int] | None = None,
    overrides: Mapping[str, Any] | None = None,
    progress: bool | None = None,
) -> DetectResult:
    """Detect and follow lines in pictures of a camera.

    - pictures: a video, a folder of pictures or a 'glob*.jpg'.
    - camera: its YAML file.
    - detector: a name, or a file of one's own.
    - right: the pictures of the second camera of a stereo pair.
    - frames: the first frame id and the one after the last.
    - overrides: parameters of the detector by name.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Raises InputError for pictures that cannot be used, and whatever does not fit together.

    >>> import egolane_pgm as ego
    >>> ego.detect("drive.avi", camera="camera.yaml", frames=(10, 10))
    Traceback (most recent call last):
    ...
    egolane_pgm.types.InputError: --frames 10 10: is an empty range
    """
    found = detect_some(
        pictures,
        camera=camera,
        detector=detector,
        right=right,
        frames=frames,
        overrides=overrides,
        progress=progress,
    )
    if found.stopped is not None:
        raise found.stopped
    return found


def detect_some(
    pictures: str | os.PathLike[str],
    *,
    camera: str | os.PathLike[str],
    detector: str = "ml",
    right: str | os.PathLike[str] | None = None,
    frames: tuple[int, int] | None = None,
    overrides: Mapping[str, Any] | None = None,
    progress: bool | None = None,
) -> DetectResult:
    """As `detect`, but what ends it early is in `stopped`, beside the lines before it."""
    if frames is not None and frames[0] >= frames[1]:
        raise InputError(f"--frames {frames[0]} {frames[1]}: is an empty range")
    pictures, camera = path_of(pictures, "pictures"), path_of(camera, "camera")
    given = keys_of(overrides, "overrides", "{'lri_frames': 5}")
    found = find_detector(
        path_of(detector, "detector"),
        {key.removeprefix("detector_parameters."): value for key, value in given.items()},
        Path.cwd(),
        "--detector",
        "--set detector_parameters",
    )
    of_camera = read_camera(Path(camera))
    check_pair(found, of_camera, right is not None, "--right")
    left = open_source(pictures)
    of_camera = camera_of_pictures(of_camera, left)
    second = open_source(path_of(right, "right")) if right is not None else None
    began = time.perf_counter()
    with bar(
        read_pictures(left, of_camera, second, frames),
        progress,
        desc=found.name,
        unit="frame",
        total=None if frames else left.n_frames,
    ) as shows:
        lines = detect_lines(found, of_camera, shows, left.frame_rate)
        done = collect(lines, left.frame_rate or 10.0, pictures)
    if done.log is None:
        raise done.stopped or InputError(f"{pictures}: no frame")
    seconds = time.perf_counter() - began
    rate = left.frame_rate
    return DetectResult(done.log, pictures, found.name, rate, seconds, done.stopped)
