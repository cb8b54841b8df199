"""Where a car was, by its GNSS receiver: tables, GPX, NMEA, and bags of ROS 1 and ROS 2.

One reader per format; `read_positions` picks it by the file's extension. Times are seconds. A
number stays what it is; a date becomes seconds since 1970, UTC.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import read_text
from egolane_pgm.types import BoolArray, FloatArray, InputError, suggestion

if TYPE_CHECKING:
    pass

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

#: A receiver's standard deviation at a dilution of precision of 1, metres. NMEA gives the dilution
#: only.
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
    """Read the positions of a drive: .csv, .parquet, .gpx, .nmea (or .nma), or of a bag those in
    sensor_msgs/NavSatFix: .bag, .mcap, .db3 or the folder of a ROS 2 bag.

    - columns: of a table, which of its columns is which of COLUMNS, as {"latitude": "lat_gps"};
      by default those with a usual name
    - topic: of a bag; by default the only one that carries positions

    Raises InputError for another extension, a file that cannot be read, an option that does not go
    with the format, and what `Positions.make` refuses.
    """
    path = Path(path)
    kind = path.suffix.lower()
    read: Any = {
        ".csv": _read_table,
        ".parquet": _read_table,
        ".gpx": _read_gpx,
        ".nmea": _read_nmea,
        ".nma": _read_nmea,
        ".bag": _read_bag,
        ".mcap": _read_bag,
        ".db3": _read_bag,
    }.get(kind, _read_bag if path.is_dir() else None)
    if read is None:
        raise InputError(
            f"{path}: unknown extension '{path.suffix}' of positions"
            " (.csv, .parquet, .gpx, .nmea, .bag, .mcap, .db3)"
        )
    if columns and read is not _read_table:
        raise InputError(f"{path}: columns are named for a table, .csv or .parquet")
    if topic is not None and read is not _read_bag:
        raise InputError(f"{path}: a topic is named for a bag")
    if not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: no such file")
    given = {_read_table: columns, _read_bag: topic}.get(read)
    positions: Positions = read(path, given) if read in (_read_table, _read_bag) else read(path)
    return positions


# --- tables ----------------------------------------------------------------------------------


def _read_table(path: Path, columns: Mapping[str, str] | None) -> Positions:
    # `egolane locate --help` does without pyarrow.
    from egolane_pgm.recordings.columns import typed
    from egolane_pgm.recordings.table import read_columns

    table = read_columns(path)
    values = {}
    for ours, theirs in _column_names(path, table.column_names, dict(columns or {})).items():
        times = _dates(path, theirs, table[theirs]) if ours == "t_s" else None
        values[ours] = typed(path, ours, table[theirs], theirs) if times is None else times
    return Positions.make(**values, source=str(path))


def _column_names(path: Path, there: list[str], chosen: dict[str, str]) -> dict[str, str]:
    """The table's name of each of our columns."""
    for ours, theirs in chosen.items():
        if ours not in COLUMNS:
            raise InputError(f"{path}: unknown column '{ours}'{suggestion(ours, COLUMNS)}")
        if theirs not in there:
            raise InputError(f"{path}: no column '{theirs}'{suggestion(theirs, there)}")
    found = dict(chosen)
    for ours, usual in COLUMNS.items():
        known = next((name for name in usual if name in there), None)
        if known is not None:
            found.setdefault(ours, known)
    lacking = [ours for ours in _NEEDED if ours not in found]
    if lacking:
        raise InputError(
            f"{path}: no column {', '.join(lacking)}; the table has {', '.join(there) or 'none'}"
        )
    twice = next((theirs for theirs in found.values() if there.count(theirs) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: column {twice} occurs more than once")
    return found


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


# --- GPX, NMEA, bags -------------------------------------------------------------------------


def _read_gpx(path: Path) -> Positions:
    """The points of all tracks, in their order."""
    with needed(f"{path}", "maps"):
        import gpxpy
    try:
        points = list(gpxpy.parse(read_text(path)).walk(only_points=True))
    except gpxpy.gpx.GPXException as error:
        text = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: is not GPX ({text})") from None
    timeless = [k for k, point in enumerate(points) if point.time is None]
    if timeless:
        raise InputError(f"{path}: position {timeless[0] + 1} has no time")
    rows = [
        (_seconds(p.time), p.latitude, p.longitude, _or_nan(p.speed), _or_nan(p.course))
        for p in points
    ]
    return _from_rows(path, rows)


def _read_nmea(path: Path) -> Positions:
    """The fixes of RMC and GGA sentences. RMC has the date, speed and course, GGA the dilution of
    precision; those of one time are one position."""
    with needed(f"{path}", "maps"):
        import pynmea2
    found: dict[datetime, dict[str, float]] = {}
    date, clock, waiting = None, None, []
    damaged = sentences = 0
    for line in read_text(path).splitlines():
        if not line.startswith("$") or line[3:6] not in ("RMC", "GGA"):
            continue
        sentences += 1
        try:
            said = pynmea2.parse(line, check=True)
            # Fields are read only where they are asked for; a damaged time or date stays text.
            values = _nmea_values(said)
            when = (said.timestamp, getattr(said, "datestamp", None))
            if any(isinstance(each, str) and each for each in when):
                raise ValueError
        except (pynmea2.ParseError, ValueError):
            damaged += 1
            continue
        if not said.timestamp:
            continue
        if said.sentence_type == "RMC":
            if not said.datestamp:
                continue
            date = said.datestamp
        elif date is None:
            waiting.append((said.timestamp, values))
            continue
        elif clock is not None and said.timestamp < clock and clock.hour - said.timestamp.hour > 12:
            # A GGA just after midnight comes before the RMC that says the new date.
            date += timedelta(days=1)
        clock = said.timestamp
        for at, its in (*waiting, (clock, values)):
            moment = datetime.combine(date, at.replace(tzinfo=None), tzinfo=UTC)
            found.setdefault(moment, {}).update(its)
        waiting = []
    if waiting:
        raise InputError(f"{path}: has no date, which an RMC sentence would give")
    if damaged:
        warnings.warn(
            f"{path}: left out {damaged} of {sentences} sentences that are damaged",
            UserWarning,
            stacklevel=3,
        )
    names = ("latitude", "longitude", "speed_mps", "heading_deg", "sigma_m")
    rows = [
        (_seconds(when), *(said.get(name, np.nan) for name in names))
        for when, said in sorted(found.items())
    ]
    return _from_rows(path, rows)


def _nmea_values(said: Any) -> dict[str, float]:
    values = {}
    is_fix = said.status == "A" if said.sentence_type == "RMC" else bool(said.gps_qual)
    if is_fix and said.lat and said.lon:
        values = {"latitude": said.latitude, "longitude": said.longitude}
    if said.sentence_type == "RMC":
        values["speed_mps"] = _or_nan(said.spd_over_grnd) * 1852 / 3600
        values["heading_deg"] = _or_nan(said.true_course)
    elif said.horizontal_dil and float(said.horizontal_dil) > 0:
        values["sigma_m"] = SIGMA_PER_HDOP_M * float(said.horizontal_dil)
    return values


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


def _seconds(when: datetime) -> float:
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _from_rows(path: Path, rows: Sequence[tuple[float, ...]]) -> Positions:
    """Positions of rows (time, latitude, longitude, speed, heading and perhaps sigma)."""
    if not rows:
        raise InputError(f"{path}: has no position")
    columns: NDArray[np.float64] = np.array(rows, dtype=np.float64).T
    names = ("speed_mps", "heading_deg", "sigma_m")
    return Positions.make(
        *columns[:3], **dict(zip(names, columns[3:], strict=False)), source=str(path)
    )
