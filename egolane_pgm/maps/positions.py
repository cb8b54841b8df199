"""Positions of a GNSS receiver: tables, GPX, and bags of ROS 1 and ROS 2.

One reader per format; `read_positions` picks it by the file's extension. Times are seconds: numbers
as they are, and dates as seconds since 1970, UTC.
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

#: The names that a table's columns may have. The first of each is the one that this package uses.
COLUMNS = {
    "t_s": ("t_s", "t", "time_s", "time", "timestamp"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng", "long"),
    "speed_mps": ("speed_mps",),
    "heading_deg": ("heading_deg",),
    "sigma_m": ("sigma_m",),
}
_NEEDED = ("t_s", "latitude", "longitude")

#: A receiver's standard deviation at a horizontal dilution of precision of 1, metres. GPX has the
#: dilution only.
SIGMA_PER_HDOP_M = 3.0


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
        """Check T rows as they come from a receiver. Rows without a fix (NaN, or exactly 0 north
        0 east) and those that repeat a time are left out, with one warning each.

        Raises InputError for a time that is no number or goes back, a latitude beyond 90 degrees or
        a longitude beyond 180, a standard deviation that is not positive, and where no row is left.
        """
        unknown = np.full(len(t_s), np.nan)
        columns = [
            np.asarray(unknown if values is None else values, dtype=np.float64)
            for values in (t_s, latitude, longitude, speed_mps, heading_deg, sigma_m)
        ]
        time, north, east, _, _, sigma = columns
        _refuse(source, ~np.isfinite(time), "has no time")
        _refuse(source, np.abs(north) > 90, "has a latitude beyond 90 degrees")
        _refuse(source, np.abs(east) > 180, "has a longitude beyond 180 degrees")
        _refuse(source, sigma <= 0, "has a sigma_m that is not greater than 0")
        back = np.diff(time, prepend=time[:1]) < 0
        _refuse(source, back, "is earlier than the one before; sort the rows by time")
        has_fix = np.isfinite(north) & np.isfinite(east) & ~((north == 0) & (east == 0))
        _warn(source, ~has_fix, "without a fix")
        first = np.concatenate([[True], np.diff(time[has_fix]) > 0])[: has_fix.sum()]
        _warn(source, ~first, "with the time of the one before")
        kept = np.flatnonzero(has_fix)[first]
        if not len(kept):
            raise InputError(f"{source}: has no position")
        time, north, east, speed, heading, sigma = (values[kept] for values in columns)
        return cls(time, north, east, speed, heading, sigma, source)


def _refuse(source: str, bad: BoolArray, why: str) -> None:
    if bad.any():
        raise InputError(f"{source}: position {int(np.argmax(bad)) + 1} {why}")


def _warn(source: str, marked: BoolArray, what: str) -> None:
    if marked.any():
        warnings.warn(
            f"{source}: left out {int(marked.sum())} of {len(marked)} positions {what}",
            UserWarning,
            stacklevel=3,
        )


def read_positions(
    path: str | Path, *, columns: Mapping[str, str] | None = None, topic: str | None = None
) -> Positions:
    """Read the positions of a drive from a .csv, .parquet or .gpx, or from the
    sensor_msgs/NavSatFix of a bag: .bag, .mcap, .db3 or the folder of a ROS 2 bag.

    - columns: names of a table's columns by those of COLUMNS, as {"latitude": "lat_gps"}; by
      default those with a usual name
    - topic: of a bag; by default the only one that carries positions

    Raises InputError for another extension, a file that cannot be read, an option that does not go
    with the format, and what `Positions.make` refuses.
    """
    path = Path(path)
    kind = path.suffix.lower()
    is_table, is_bag = kind in (".csv", ".parquet"), kind in (".bag", ".mcap", ".db3")
    if not (is_table or is_bag or kind == ".gpx" or path.is_dir()):
        raise InputError(
            f"{path}: unknown extension '{path.suffix}' of positions"
            " (.csv, .parquet, .gpx, .bag, .mcap, .db3)"
        )
    if columns and not is_table:
        raise InputError(f"{path}: columns are named for a table, .csv or .parquet")
    if topic is not None and (is_table or kind == ".gpx"):
        raise InputError(f"{path}: a topic is named for a bag")
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if is_table:
        return _read_table(path, columns or {})
    return _read_gpx(path) if kind == ".gpx" else _read_bag(path, topic)


# --- tables ----------------------------------------------------------------------------------


def _read_table(path: Path, columns: Mapping[str, str]) -> Positions:
    # `egolane locate --help` does without pyarrow.
    from egolane_pgm.recordings.columns import typed
    from egolane_pgm.recordings.table import read_columns

    table = read_columns(path)
    there = table.column_names
    for ours, theirs in columns.items():
        if ours not in COLUMNS:
            raise InputError(f"{path}: unknown column '{ours}'{suggestion(ours, COLUMNS)}")
        if theirs not in there:
            raise InputError(f"{path}: no column '{theirs}'{suggestion(theirs, there)}")
    values = {}
    for ours, usual in COLUMNS.items():
        theirs = columns.get(ours) or next((name for name in usual if name in there), "")
        if theirs:
            times = _dates(path, theirs, table[theirs]) if ours == "t_s" else None
            values[ours] = typed(path, ours, table[theirs], theirs) if times is None else times
        elif ours in ("t_s", "latitude", "longitude"):
            raise InputError(
                f"{path}: no column {ours}; the table has {', '.join(there) or 'none'}"
            )
    return Positions.make(**values, source=str(path))


def _dates(path: Path, name: str, column: Any) -> FloatArray | None:
    """The times of a column of dates in ISO 8601, (T,), seconds; those without a zone are UTC. None
    for a column of numbers."""
    import pandas as pd

    cells = column.to_pandas()
    if pd.api.types.is_numeric_dtype(cells) or cells.isna().all():
        return None
    try:
        date = pd.to_datetime(cells, errors="coerce", utc=True, format="ISO8601").dt.as_unit("ns")
    except pd.errors.OutOfBoundsDatetime as error:
        raise InputError(f"{path}: {name}: {error}") from None
    bad = (date.isna() & cells.notna()).to_numpy()
    if bad.any():
        row = int(np.argmax(bad))
        cell = str(cells.iloc[row])[:40]
        raise InputError(f"{path}: row {row + 1}: {name} is {cell!r}, not a number or a date")
    return np.asarray((date - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1), np.float64)


# --- GPX and bags ----------------------------------------------------------------------------


def _read_gpx(path: Path) -> Positions:
    """The points of all tracks, in their order."""
    with needed(f"{path}", "maps"):
        import gpxpy
    try:
        points = list(gpxpy.parse(read_text(path)).walk(only_points=True))
    except gpxpy.gpx.GPXException as error:
        text = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: is not GPX ({text})") from None
    rows = np.full((6, len(points)), np.nan)
    for row, p in zip(rows.T, points, strict=True):
        if p.time is not None:
            row[0] = (p.time if p.time.tzinfo else p.time.replace(tzinfo=UTC)).timestamp()
        row[1:] = [
            np.nan if value is None else value
            for value in (p.latitude, p.longitude, p.speed, p.course, p.horizontal_dilution)
        ]
    t_s, latitude, longitude, speed, heading, dilution = rows
    sigma = np.where(dilution > 0, SIGMA_PER_HDOP_M * dilution, np.nan)
    return Positions.make(
        t_s, latitude, longitude, speed_mps=speed, heading_deg=heading, sigma_m=sigma,
        source=str(path),
    )  # fmt: skip


#: The name of the message type of a receiver's fixes, whatever its package.
_FIX = "NavSatFix"


def _read_bag(path: Path, topic: str | None) -> Positions:
    """The fixes on a topic, by default the only one that carries some; by the headers' stamps."""
    # What reads bags is loaded for them only.
    from egolane_pgm.recordings.topics import messages, topics_of

    there = topics_of(path)
    names = {name for name, (kind, _) in there.items() if kind.split("/")[-1] == _FIX}
    if topic is None:
        if len(names) != 1:
            several = f"; name one of {', '.join(sorted(names))}" if names else ""
            raise InputError(f"{path}: {len(names)} topics of type {_FIX} in the bag{several}")
        (topic,) = names
    rows = []
    for message in messages(path, [topic]):
        if message.topic not in names:
            kind, _ = there[message.topic]
            raise InputError(f"{path}: topic {topic} has type {kind}, which is not {_FIX}")
        fix = message.value
        is_fix = fix["status"]["status"] >= 0
        place = (fix["latitude"], fix["longitude"]) if is_fix else (np.nan, np.nan)
        # East and north; a covariance of zeros says that it is not known.
        variance = (fix["position_covariance"][0] + fix["position_covariance"][4]) / 2
        rows.append((message.time_s, *place, np.sqrt(variance) if variance > 0 else np.nan))
    t_s, latitude, longitude, sigma_m = np.array(rows, dtype=np.float64).T
    return Positions.make(t_s, latitude, longitude, sigma_m=sigma_m, source=str(path))
