"""A drive as a recording of rerun, with a blueprint that lays it out.

Two timelines: `time` (since 1970, or since the drive's beginning of time) and `frame`. Entities:

    belief/NODE    the belief in each value of a hidden node, curves
    lanes/NAME     the lanes of model, detector and truth, curves; 0 Unassigned
    bars           the belief over the lanes as bars from left to right, the truth marked below
    birdseye/...   the lines seen from above and the car, in metres, ahead is up
    offsets        the lines' offsets over time, metres, right is up
    picture        the pictures, as JPEG
    changes        the lane changes that are reported
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.export.drive import AHEAD_M, BAR_GAP_M, BAR_HEIGHT_M, TRUTH, Drive
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import atomic
from egolane_pgm.types import FloatArray, IntArray

with needed("an .rrd file", "rerun"):
    import rerun as rr
    import rerun.blueprint as rrb

#: Pictures in memory at a time.
_BATCH = 50

#: The colours of curves: Okabe and Ito's.
_COLOURS = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (213, 94, 0),
    (204, 121, 167),
    (86, 180, 233),
    (240, 228, 66),
    (120, 120, 120),
)
_LANE_COLOURS = {"model": (0, 114, 178), "detector": (230, 159, 0), "truth": TRUTH}


def write_rrd(path: Path, drive: Drive) -> dict[str, int]:
    """Write a drive; returns the number of rows per entity. Raises InputError where the
    file cannot be written or a picture cannot be read."""
    with atomic(path) as temporary:
        recording = rr.RecordingStream("egolane", recording_id=drive.result.name)
        recording.save(temporary, default_blueprint=_blueprint(drive))
        recording.send_recording_name(drive.result.name)
        counts: dict[str, int] = {}
        for entity, rows, columns in _entities(drive):
            recording.send_columns(entity, indexes=_times(drive, rows), columns=columns)
            counts[entity] = counts.get(entity, 0) + len(rows)
        for entity, what in _lasting(drive):
            recording.log(entity, what, static=True)
        recording.flush()
        recording.disconnect()
    return counts


def _times(drive: Drive, rows: IntArray) -> list[Any]:
    kind = ("timestamp", "datetime64[ns]") if drive.is_dated else ("duration", "timedelta64[ns]")
    time = drive.time_ns[rows].astype(kind[1])
    return [
        rr.TimeColumn("time", **{kind[0]: time}),
        rr.TimeColumn("frame", sequence=drive.result.frame_id[rows]),
    ]


def _entities(drive: Drive) -> Iterator[tuple[str, IntArray, Any]]:
    """The entities that change: name, rows of the drive, columns of data for these."""
    every = np.arange(len(drive))
    for node, (_, belief) in drive.beliefs().items():
        yield f"belief/{node}", every, _curves(belief)
    for name, (lane, is_known) in drive.lane_curves().items():
        yield f"lanes/{name}", every[is_known], _curves(lane[is_known, None].astype(float))
    yield "bars", every, _bars(drive)
    if drive.result.lines is not None:
        yield "birdseye/lines", every, _lines(drive)
        if drive.result.lines.offset_m.shape[1]:
            offset = np.where(drive.result.lines.is_valid, drive.result.lines.offset_m, np.nan)
            yield "offsets", every, _curves(offset)
    texts = drive.event_texts()
    if texts:
        rows = np.array([row for row, _ in texts])
        yield "changes", rows, rr.TextLog.columns(text=[text for _, text in texts])
    pictures = drive.jpegs()
    while batch := list(islice(pictures, _BATCH)):
        files = [np.frombuffer(jpeg, dtype=np.uint8) for _, jpeg in batch]
        kinds = ["image/jpeg"] * len(batch)
        rows = np.array([row for row, _ in batch])
        yield "picture", rows, rr.EncodedImage.columns(blob=files, media_type=kinds)


def _curves(values: FloatArray) -> Any:
    """Values (T, k) as k curves."""
    n_frames, n_curves = values.shape
    return rr.Scalars.columns(scalars=values.ravel()).partition([n_curves] * n_frames)


def _bars(drive: Drive) -> Any:
    """Boxes whose heights are the beliefs; below the true lane a flat one."""
    centers, sizes, colours, counts = [], [], [], []
    for t in range(len(drive)):
        bars = drive.bars_at(t)
        for right, belief, colour, _ in bars:
            high = max(belief * BAR_HEIGHT_M, 0.02)
            centers.append((right, -high / 2))
            sizes.append((0.8 * BAR_GAP_M, high))
            colours.append(colour)
        marks = [right for right, _, _, is_true in bars if is_true]
        centers += [(right, 0.3) for right in marks]
        sizes += [(0.9 * BAR_GAP_M, 0.4)] * len(marks)
        colours += [TRUTH] * len(marks)
        counts.append(len(bars) + len(marks))
    half = np.array(sizes) / 2
    return rr.Boxes2D.columns(
        centers=np.array(centers), half_sizes=half, colors=np.array(colours, dtype=np.uint8)
    ).partition(counts)


def _lines(drive: Drive) -> Any:
    strips, colours, radii, counts = [], [], [], []
    for t in range(len(drive)):
        seen = drive.lines_at(t)
        counts.append(len(seen))
        for right, colour, is_valid, _ in seen:
            strips.append([(right, 0.0), (right, -AHEAD_M)])
            colours.append(colour)
            radii.append(0.12 if is_valid else 0.05)
    return rr.LineStrips2D.columns(
        strips=np.array(strips).reshape(-1, 2, 2),
        colors=np.array(colours, dtype=np.uint8).reshape(-1, 3),
        radii=np.array(radii),
    ).partition(counts)


def _lasting(drive: Drive) -> Iterator[tuple[str, Any]]:
    """What does not change: the names and colours of curves, and the car."""
    for node, (values, _) in drive.beliefs().items():
        names = [f"lane {value}" if node == "Lane" else value for value in values]
        yield f"belief/{node}", rr.SeriesLines(names=names, colors=_colours(len(names)))
    for name in drive.lane_curves():
        yield f"lanes/{name}", rr.SeriesLines(names=[name], colors=[_LANE_COLOURS[name]])
    n_lines = 0 if drive.result.lines is None else drive.result.lines.offset_m.shape[1]
    if n_lines:
        names = [f"line {k + 1}" for k in range(n_lines)]
        yield "offsets", rr.SeriesPoints(names=names, colors=_colours(n_lines), marker_sizes=[1.5])
    car = rr.Boxes2D(centers=[(0.0, 2.25)], half_sizes=[(0.9, 2.25)], colors=[(120, 120, 120)])
    yield "birdseye/car", car
    places = [(right, 1.2) for right, *_ in drive.bars_at(0)]
    names = [f"lane {k + 1}" for k in range(len(places))]
    yield "bars/names", rr.Points2D(places, labels=names, radii=[0.01], show_labels=True)


def _colours(n: int) -> Sequence[tuple[int, int, int]]:
    return [_COLOURS[k % len(_COLOURS)] for k in range(n)]


def _blueprint(drive: Drive) -> Any:
    """What is seen on the left, what was believed on the right."""
    half = drive.result.n_lanes / 2 * BAR_GAP_M
    around = rrb.VisualBounds2D(x_range=(-half, half), y_range=(-BAR_HEIGHT_M - 0.5, 2.0))
    seen = [rrb.Spatial2DView(origin="bars", name="belief over the lanes", visual_bounds=around)]
    if drive.result.lines is not None:
        around = rrb.VisualBounds2D(x_range=(-16.0, 16.0), y_range=(-AHEAD_M, 6.0))
        view = rrb.Spatial2DView(origin="birdseye", name="from above", visual_bounds=around)
        seen.insert(0, view)
    if drive.pictures is not None:
        seen.insert(0, rrb.Spatial2DView(origin="picture", name="picture"))
    believed: list[Any] = [
        rrb.TimeSeriesView(origin=f"belief/{node}", name=f"belief: {node}")
        for node in drive.beliefs()
    ]
    believed.append(rrb.TimeSeriesView(origin="lanes", name="lanes; 0: none"))
    if drive.result.lines is not None:
        believed.append(
            rrb.TimeSeriesView(origin="offsets", name="valid lines, metres to the right")
        )
    believed.append(rrb.TextLogView(origin="changes", name="lane changes"))
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*seen), rrb.Vertical(*believed)), collapse_panels=True
    )
