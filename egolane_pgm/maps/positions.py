"""Positions of a GNSS receiver from tables, GPX, and bags of ROS 1 and ROS 2.

Times are seconds; dates are seconds since 1970, UTC.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import BoolArray, FloatArray, InputError, suggestion

#: Accepted names of a table's columns. The first of each is our own.
COLUMNS = {
    "t_s": ("t_s", "t", "time_s", "time", "timestamp"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng", "long"),
    "speed_mps": ("speed_mps",),
    "heading_deg": ("heading_deg",),
    "sigma_m": ("sigma_m",),
}

#: A receiver's standard deviation at a horizontal dilution of precision of 1, metres. GPX has the
#: dilution only.
SIGMA_PER_HDOP_M = 3.0

#: The name of the message type of a receiver's fixes, in any package.
_FIX = "NavSatFix"


@dataclass(frozen=True)
class Positions:
    """T positions of a GNSS receiver.

    - t_s (T,): seconds, strictly increasing
    - latitude, longitude (T,): degrees, WGS 84
    - speed_mps (T,): metres per second; NaN unknown
    - heading_deg (T,): direction of travel, degrees clockwise from north; NaN unknown
    - sigma_m (T,): horizontal standard deviation along one axis, metres; NaN unknown
    - source: the file, for messages
    """

    t_s: FloatArray
    latitude: FloatArray
    longitude: FloatArray
    speed_mps: FloatArray
    heading_deg: FloatArray
    sigma_m: FloatArray
    source: str = "positions"

    def __len__(self) -> int:
        return len(self.t_s)

    @classmethod
    def make(
        cls,
        t_s: FloatArray,
        latitude: FloatArray,
        longitude: FloatArray,
        *,
        speed_mps: FloatArray | None = None,
        heading_deg: FloatArray | None = None,
        sigma_m: FloatArray | None = None,
        source: str = "positions",
    ) -> Positions:
        """Check T rows of a receiver. Rows without a fix (NaN, or exactly 0 north 0 east) and rows
        that repeat a time are left out, with one warning each.

        Raises InputError for a time that is missing or goes back, a latitude beyond 90 degrees, a
        longitude beyond 180, a standard deviation that is not positive, and if no row is left.
        """
        unknown = np.full(len(t_s), np.nan)
        columns = [
            np.asarray(unknown if values is None else values, dtype=np.float64)
            for values in (t_s, latitude, longitude, speed_mps, heading_deg, sigma_m)
        ]
        time, north, east, _, _, sigma = columns
        checks = (
            (~np.isfinite(time), "has no time"),
            (np.abs(north) > 90, "has a latitude beyond 90 degrees"),
            (np.abs(east) > 180, "has a longitude beyond 180 degrees"),
            (sigma <= 0, "has a sigma_m that is not greater than 0"),
            (np.diff(time, prepend=time[:1]) < 0, "is earlier than the one before; sort by time"),
        )
        for bad, problem in checks:
            if bad.any():
                raise InputError(f"{source}: position {int(np.argmax(bad)) + 1} {problem}")
        has_fix = np.isfinite(north) & np.isfinite(east) & ~((north == 0) & (east == 0))
        _warn(source, ~has_fix, "without a fix")
        first = np.concatenate([[True], np.diff(time[has_fix]) > 0])[: has_fix.sum()]
        _warn(source, ~first, "with the time of the one before")
        kept = np.flatnonzero(has_fix)[first]
        if not len(kept):
            raise InputError(f"{source}: has no position")
        time, north, east, speed, heading, sigma = (values[kept] for values in columns)
        return cls(time, north, east, speed, heading, sigma, source)


def _warn(source: str, marked: BoolArray, what: str) -> None:
    if marked.any():
        warnings.warn(
            f"{source}: left out {int(marked.sum())} of {len(marked)} positions {what}",
            UserWarning,
            stacklevel=4,
        )


def read_positions(path: str | Path, *, columns: Mapping[str, str] | None = None) -> Positions:
    """Read the positions of a drive from a .csv, .parquet or .gpx, or from the
    sensor_msgs/NavSatFix of a bag: .bag, .mcap, .db3 or the folder of a ROS 2 bag.

    - columns: other names of a table's columns (keys of COLUMNS), {"latitude": "lat_gps"}; or the
      topic in a bag, {"topic": "/fix"}, if several have positions.

    Raises InputError for a file that cannot be read, for columns that do not go with the format,
    and as `Positions.make`.
    """
    path, columns = Path(path), dict(columns or {})
    kind = path.suffix.lower()
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if kind in (".csv", ".parquet"):
        return _read_table(path, columns)
    if kind in (".bag", ".mcap", ".db3") or path.is_dir():
        topic = columns.pop("topic", None)
        known = "topic"
    elif kind == ".gpx":
        known = "none"
    else:
        raise InputError(
            f"{path}: unknown extension '{path.suffix}' of positions"
            " (.csv, .parquet, .gpx, .bag, .mcap, .db3)"
        )
    if columns:
        raise InputError(f"{path}: unknown column '{next(iter(columns))}' (known: {known})")
    return _read_gpx(path) if kind == ".gpx" else _read_bag(path, topic)


def _read_table(path: Path, columns: Mapping[str, str]) -> Positions:
    # pyarrow is imported for tables only.
    from egolane_pgm.recordings.columns import to_numbers, to_seconds
    from egolane_pgm.recordings.table import read_columns

    table = read_columns(path)
    there = list(table)
    for ours, theirs in columns.items():
        if ours not in COLUMNS:
            raise InputError(f"{path}: unknown column '{ours}'{suggestion(ours, COLUMNS)}")
        if theirs not in there:
            raise InputError(f"{path}: no column '{theirs}'{suggestion(theirs, there)}")
    values: dict[str, Any] = {}
    for ours, usual in COLUMNS.items():
        theirs = columns.get(ours) or next((name for name in usual if name in there), "")
        if theirs:
            read = to_seconds if ours == "t_s" else to_numbers
            values[ours] = read(path, ours, table[theirs], theirs)
        elif ours in ("t_s", "latitude", "longitude"):
            raise InputError(
                f"{path}: no column {ours}; the table has {', '.join(there) or 'none'}"
            )
    return Positions.make(**values, source=str(path))


def _read_gpx(path: Path) -> Positions:
    """Read the points of all tracks, in their order."""
    with needed(f"{path}", "maps"):
        import gpxpy
    try:
        points = list(gpxpy.parse(read_text(path)).walk(only_points=True))
    except gpxpy.gpx.GPXException as error:
        text = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: is not GPX ({text})") from None
    t_s = [
        np.nan if p.time is None else p.time.replace(tzinfo=p.time.tzinfo or UTC).timestamp()
        for p in points
    ]
    names = ("latitude", "longitude", "speed", "course", "horizontal_dilution")
    # None becomes NaN.
    rows = np.array([[getattr(p, name) for name in names] for p in points], dtype=np.float64)
    latitude, longitude, speed, heading, dilution = rows.reshape(-1, len(names)).T
    sigma = np.where(dilution > 0, SIGMA_PER_HDOP_M * dilution, np.nan)
    return Positions.make(
        np.array(t_s), latitude, longitude, speed_mps=speed, heading_deg=heading, sigma_m=sigma,
        source=str(path),
    )  # fmt: skip


def _read_bag(path: Path, topic: str | None) -> Positions:
    """Read the fixes on a topic, by default the only one that has some."""
    # rosbags is imported for bags only.
    from egolane_pgm.recordings.topics import fields_of, topics_of

    there = topics_of(path)
    names = [name for name, (kind, _) in there.items() if kind.split("/")[-1] == _FIX]
    chosen = [name for name in names if topic in (None, name)]
    if len(chosen) != 1:
        what = f"{len(chosen)} topics of type {_FIX}" + (f" named {topic}" if topic else "")
        several = f"; name one of {', '.join(sorted(names))} as column topic" if names else ""
        raise InputError(f"{path}: {what}{several}")
    fix = fields_of(path, chosen[0])
    has_fix = np.asarray(fix["status.status"]) >= 0
    latitude, longitude = (
        np.where(has_fix, fix[name], np.nan) for name in ("latitude", "longitude")
    )
    # East and north; a covariance of zeros is unknown.
    covariance = np.stack(fix["position_covariance"])
    variance = (covariance[:, 0] + covariance[:, 4]) / 2
    sigma = np.sqrt(np.where(variance > 0, variance, np.nan))
    return Positions.make(
        np.asarray(fix["time_s"]), latitude, longitude, sigma_m=sigma, source=str(path)
    )
