"""Positions of a GNSS receiver from tables, GPX, and bags of ROS 1 and ROS 2.

Times are seconds; dates are seconds since 1970, UTC.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path

import numpy as np
import pandas as pd

from egolane_pgm.recordings.clock import unit_of
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import FloatArray, InputError, suggestion

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

#: The columns that a table must have.
NEEDED = ("t_s", "latitude", "longitude")

#: Plausible seconds between two positions.
_STEP_S = (0.01, 60.0)

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
        source: str = "positions",
        **further: FloatArray,
    ) -> Positions:
        """Check T rows of a receiver. Rows without a time, without a fix (NaN, or exactly 0 north
        0 east), and rows that repeat a time are left out, with one warning each.

        - further: speed_mps, heading_deg and sigma_m, as far as they are known.

        Raises InputError for a time that goes back, a latitude beyond 90 degrees, a
        longitude beyond 180, a standard deviation that is not positive, and if no row is left.
        """
        given = {"t_s": t_s, "latitude": latitude, "longitude": longitude, **further}
        every = pd.DataFrame(given, dtype=float).reindex(columns=[*COLUMNS])
        rows = every[np.isfinite(every.t_s)]
        for bad, problem in (
            (rows.latitude.abs() > 90, "has a latitude beyond 90 degrees"),
            (rows.longitude.abs() > 180, "has a longitude beyond 180 degrees"),
            (rows.sigma_m <= 0, "has a sigma_m that is not greater than 0"),
            (rows.t_s.diff() < 0, "is earlier than the position before; sort by time"),
        ):
            if bad.any():
                raise InputError(f"{source}: position {int(bad.idxmax()) + 1} {problem}")
        place = rows[["latitude", "longitude"]]
        has_fix = np.isfinite(place).all(axis=1) & (place != 0).any(axis=1)
        fixes = rows[has_fix]
        kept = fixes.drop_duplicates("t_s")
        for n_left, before, what in (
            (len(rows), every, "without a time"),
            (len(fixes), rows, "without a fix"),
            (len(kept), fixes, "with the time of the position before"),
        ):
            if n_left < len(before):
                left_out = f"left out {len(before) - n_left} of {len(before)} positions {what}"
                warnings.warn(f"{source}: {left_out}", UserWarning, stacklevel=3)
        if kept.empty:
            raise InputError(f"{source}: has no position with a time and a fix")
        step_s = float(np.median(np.diff(kept.t_s))) if len(kept) > 1 else 1.0
        if unit_of(step_s, _STEP_S) != "s":
            unit = unit_of(step_s, _STEP_S) or "another unit"
            wrong = f"the median time between two positions is {step_s:.4g} s"
            cure = f"if the times are in {unit}, convert them to seconds"
            warnings.warn(f"{source}: {wrong}; {cure}", UserWarning, stacklevel=3)
        return cls(**{name: kept[name].to_numpy() for name in kept}, source=source)


def read_positions(path: str | Path, *, columns: Mapping[str, str] | None = None) -> Positions:
    """Read the positions of a drive from a .csv, .parquet or .gpx, or from the
    sensor_msgs/NavSatFix of a bag: .bag, .mcap, .db3 or the folder of a ROS 2 bag.

    - columns: other names of a table's columns (keys of COLUMNS), {"latitude": "lat_gps"}; or the
      topic in a bag, {"topic": "/fix"}, if several have positions.

    Raises InputError for a file that cannot be read, for columns that do not go with the format,
    and as `Positions.make`.
    """
    path = Path(path)
    columns = dict(columns or {})
    kind = ".bag" if path.is_dir() else path.suffix.lower()
    if kind not in _FORMATS:
        raise InputError(f"{path}: unknown extension '{kind}' of positions ({', '.join(_FORMATS)})")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    read, known = _FORMATS[kind]
    for ours in columns:
        if ours not in known:
            raise InputError(f"{path}: unknown column '{ours}'{suggestion(ours, known)}")
    return read(path, columns)


def _read_table(path: Path, columns: Mapping[str, str]) -> Positions:
    # pyarrow is imported for tables only.
    from egolane_pgm.recordings.columns import Column, checked
    from egolane_pgm.recordings.table import read_columns

    declared = {
        ours: Column("time" if ours == "t_s" else "number", ours in NEEDED, others=tuple(others))
        for ours, (_, *others) in COLUMNS.items()
    }
    table = checked(read_columns(path), declared, str(path), columns)
    known = {name: table[name].to_numpy() for name in COLUMNS if name in table}
    return Positions.make(**known, source=str(path))


def _read_gpx(path: Path, columns: Mapping[str, str]) -> Positions:
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


def _read_bag(path: Path, columns: Mapping[str, str]) -> Positions:
    """Read the fixes on a topic, by default the only one that has some."""
    # rosbags is imported for bags only.
    from egolane_pgm.recordings.topics import fields_of, topics_of

    topic = columns.get("topic")
    names = [name for name, (kind, _) in topics_of(path).items() if kind.endswith(f"/{_FIX}")]
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


#: Extension of a file of positions: its reader, and the keys of `columns` that it takes.
_FORMATS = {
    **dict.fromkeys((".csv", ".parquet"), (_read_table, (*COLUMNS,))),
    ".gpx": (_read_gpx, ()),
    **dict.fromkeys((".bag", ".mcap", ".db3"), (_read_bag, ("topic",))),
}
