"""What 100,000 hours of driving take: processor hours, storage, files; from what one hour takes.

`python -m tests.benchmarks.bench_planning` prints the tables alone; docs/planning.md explains them.
Processor time of one thread. A fleet of one drive is run at two lengths: the difference is what an
hour takes, the rest is there for every drive. The first run of all does not count.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import egolane_pgm as ego
from egolane_pgm.recordings import write_lines
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.simulation import simulate
from tests.benchmarks.bench_camera import Line, camera_lines
from tests.benchmarks.timing import machine

HOURS = 100_000
#: Frames per second of the lines, and of the pictures that they are detected in.
FRAME_RATE = 10
EXPERIMENTS = {"the paper's graph": "quickstart.yaml", "zero_label": "zero_label.yaml"}
#: Frames of the short drive and of the long one, an hour; and how many short ones make a fleet.
SHORT, LONG, MANY = 600, 36_000, 40
#: Machines' cores in the plan, and hours of a drive.
CORES, DRIVE_HOURS = 64, 1.0


@dataclass(frozen=True)
class Cost:
    """What one experiment takes on a fleet. Seconds of one processor; bytes written.

    cpu_s, bytes_: of an hour of driving. cpu_s_drive, bytes_drive, files_drive: of every drive,
    however short. summary_bytes: of a row of summary.parquet. resume_s: of a drive that is done
    already, per megabyte of its recording; resume_s_drive: per drive.
    """

    what: str
    cpu_s: float
    bytes_: float
    cpu_s_drive: float
    bytes_drive: float
    files_drive: float
    summary_bytes: float
    resume_s_drive: float


@dataclass(frozen=True)
class Plan:
    """What so many hours of driving take: processor hours, days on so many cores, bytes of results,
    files, bytes of summary.parquet, hours until a repeated command has seen that all is done."""

    processor_hours: float
    days: float
    bytes_: float
    files: float
    summary_bytes: float
    resume_hours: float


def plan(cost: Cost, hours: float, drive_hours: float, cores: int) -> Plan:
    """The plan for `hours` of driving in drives of `drive_hours`, on `cores` processors that are
    always busy; a repeated command looks at one drive after the other."""
    drives = hours / drive_hours
    processor_hours = (hours * cost.cpu_s + drives * cost.cpu_s_drive) / 3600
    return Plan(
        processor_hours,
        processor_hours / cores / 24,
        hours * cost.bytes_ + drives * cost.bytes_drive,
        drives * cost.files_drive,
        drives * cost.summary_bytes,
        drives * cost.resume_s_drive / 3600,
    )


def detection_hours(seconds: float, hours: float, frame_rate: float) -> float:
    """Processor hours for the pictures of `hours` of driving, `seconds` each."""
    return hours * frame_rate * seconds


def costs(folder: Path) -> list[Cost]:
    """What each of EXPERIMENTS takes."""
    for name, frames in (("short", SHORT), ("long", LONG)):
        drive = simulate("a4", seed=0, n_lanes=4, frames=frames)
        write_lines(folder / f"{name}.parquet", drive.log)
        write_ground_truth(folder / f"{name}.txt", drive.truth)
    return [_cost(folder / place, what, place) for what, place in EXPERIMENTS.items()]


def _cost(folder: Path, what: str, place: str) -> Cost:
    folder.mkdir()
    for drives in ("short",), ("long",), ["short"] * MANY:
        _seconds(folder, place, drives, f"first {len(drives)} {drives[0]}")
    short, long = (_seconds(folder, place, [name], name) for name in ("short", "long"))
    of_short, of_long = (_size(folder / name) for name in ("short", "long"))
    _seconds(folder, place, ["short"] * MANY, "many")
    again = _seconds(folder, place, ["short"] * MANY, "many")
    nothing = _seconds(folder, place, ["short"], "short")
    per_hour = 3600 * FRAME_RATE / (LONG - SHORT)
    cpu_s, bytes_ = (long - short) * per_hour, (of_long - of_short) * per_hour
    part = SHORT / (3600 * FRAME_RATE)
    rows = (folder / "many" / "summary.parquet").stat().st_size
    row = (folder / "short" / "summary.parquet").stat().st_size
    return Cost(
        what,
        cpu_s,
        bytes_,
        max(0.0, short - nothing - cpu_s * part),
        of_short - bytes_ * part,
        sum(1 for path in (folder / "short").rglob("*") if path.is_file()) - 1,
        (rows - row) / (MANY - 1),
        (again - nothing) / (MANY - 1),
    )


def _seconds(folder: Path, place: str, drives: Sequence[str], out: str) -> float:
    """Processor time of a fleet of these drives."""
    table = folder / "drives.csv"
    rows = [f"{k},../{d}.parquet,../{d}.txt,4\n" for k, d in enumerate(drives)]
    table.write_text("name,recording,ground_truth,n_lanes\n" + "".join(rows))
    begun = time.process_time()
    ego.run(ego.experiments_folder() / place, fleet=table, out=folder / out)
    return time.process_time() - begun


def _size(folder: Path) -> int:
    """Bytes of the results of a fleet."""
    return sum(
        path.stat().st_size
        for path in folder.rglob("*")
        if path.is_file() and path.name != "summary.parquet"
    )


def markdown(found: Iterable[Cost], detected: Iterable[Line]) -> str:
    """The measured figures and the plans as Markdown tables."""
    found = list(found)
    heads = ["", *(cost.what for cost in found)]
    measured = [
        ("processor time of an hour of driving", [f"{c.cpu_s:.1f} s" for c in found]),
        ("and of every drive", [f"{c.cpu_s_drive:.2f} s" for c in found]),
        ("result of an hour", [f"{c.bytes_ / 1e6:.1f} MB" for c in found]),
        ("and of every drive", [f"{c.bytes_drive / 1e3:.0f} kB" for c in found]),
        ("files of a drive", [f"{c.files_drive:.0f}" for c in found]),
        ("row of summary.parquet", [f"{c.summary_bytes:.0f} bytes" for c in found]),
        ("a drive that is done already", [f"{1e3 * c.resume_s_drive:.0f} ms" for c in found]),
    ]
    plans = [plan(c, HOURS, DRIVE_HOURS, CORES) for c in found]
    planned = [
        ("processor hours", [f"{p.processor_hours:,.0f}" for p in plans]),
        (f"{CORES} cores, always busy", [f"{p.days:.1f} days" for p in plans]),
        ("results", [f"{p.bytes_ / 1e9:,.0f} GB" for p in plans]),
        ("files", [f"{p.files:,.0f}" for p in plans]),
        ("summary.parquet", [f"{p.summary_bytes / 1e6:,.0f} MB" for p in plans]),
        ("a command that finds all done", [f"{p.resume_hours:.1f} h" for p in plans]),
    ]
    pictures = [
        (what, [f"{1e3 * s:.1f} ms", f"{detection_hours(s, HOURS, FRAME_RATE):,.0f}"])
        for what, s in detected
        if ":" not in what
    ]
    return "\n".join(
        [
            _table(heads, measured),
            _table([f"{HOURS:,} hours", *heads[1:]], planned),
            _table(["detector, 1280x720", "per picture", "processor hours"], pictures),
        ]
    )


def _table(heads: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    lines = [f"| {' | '.join(heads)} |", f"|---|{'---:|' * (len(heads) - 1)}"]
    lines += [f"| {' | '.join([what, *cells])} |" for what, cells in rows]
    return "\n".join(lines) + "\n"


def planning_lines() -> list[Cost]:
    """What an hour of driving takes, measured in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        return costs(Path(folder))


if __name__ == "__main__":
    print(f"{machine()}.\n\n{markdown(planning_lines(), camera_lines())}")
