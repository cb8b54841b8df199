"""The examples of README.md and docs/: what stands in a page's fences, and the files that they
name."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.topics import TOPICS
from egolane_pgm.simulation import simulate
from egolane_pgm.vision.camera.model import write_camera
from tests.kits.calibration_kit import TRUE, draw_road
from tests.kits.drives import command, rewritten, write_drive
from tests.kits.image_bags import write_images
from tests.kits.image_line_files import entry, tusimple
from tests.kits.rosbag_writer import write_lines, write_rosbag
from tests.kits.sensor_files import foreign_table, own_bag, polynomials_table
from tests.kits.synthetic_road import write_video
from tests.kits.tiny_network import write_known, write_top_hat

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

#: How the lines begin that are shown and not run, and why.
NOT_RUN = {
    "make ": "installs, or takes hours; `make test` is what runs this",
    "pip ": "installs",
    "python3 -m venv": "installs",
    "git clone": "needs a network",
    "osmium ": "another program",
    "optuna": "another program",
    "egolane data fetch": "needs a network",
    "egolane tune X.yaml --storage postgresql": "needs a server",
}

#: What is run in place of what would take minutes: a pattern, and its replacement.
QUICKER = (
    (r"^(egolane run .*)--held-out", r"\1--held-out --set fit.folds=2"),
    (r"experiments/paper/recordings.csv", "examples/two_runs.csv"),
    (r"(egolane run paper_tuned .*)", r"\1 --set fit.trials=2"),
    (r"--jobs \d+", "--jobs 1"),
    (r"--frames 40\b", "--frames 10"),
    (r"(-p detector\..*)", r"\1 --folds 2"),
    (r"(--profile .*)", r"\1 --set recording.frames=[0,300]"),
    (r"--trials 3000\b", "--trials 6"),
    (r"--trials (300|40|20)\b", "--trials 3"),
    (r"fit.trials=20\b", "fit.trials=3"),
    (r"^egolane reproduce(?! --runs)", "egolane reproduce --runs 5"),
)

#: Options without which a search would take its time, where a command has none of its own.
_TUNE = " --trials 3"


@dataclass(frozen=True)
class Block:
    """What stands between two fences.

    - language: after the first fence; "" for none, which may be commands.
    - line: of the page, where it begins.
    """

    language: str
    text: str
    line: int


def blocks_of(page: Path) -> list[Block]:
    """The fenced blocks of a page, in their order."""
    text = page.read_text()
    return [
        Block(found[1], found[2], text[: found.start()].count("\n") + 2)
        for found in re.finditer(r"^```(\w*)\n(.*?)^```", text, flags=re.M | re.S)
    ]


def commands_of(block: Block) -> list[str]:
    """The command lines of a block; none of one that shows something else."""
    if block.language not in ("", "sh", "bash"):
        return []
    whole = re.sub(r"\\\n\s*", "", re.sub(r"\|\n\s*", "| ", block.text))
    lines = [re.split(r"\s+#", line)[0].strip() for line in whole.splitlines()]
    known = ("egolane ", "echo ", *NOT_RUN)
    return [line for line in lines if line.startswith(known)]


def is_run(line: str) -> bool:
    """Whether a command line is run."""
    return not line.startswith(tuple(NOT_RUN))


def quicker(line: str) -> str:
    """The command line with smaller numbers."""
    for pattern, replacement in QUICKER:
        line = re.sub(pattern, replacement, line)
    if line.startswith("egolane tune") and "--trials" not in line:
        line += _TUNE
    return line


def run_line(line: str) -> None:
    """Run a command line of `egolane`, in this process: what an `echo` gives is its input, and what
    it prints may go into a file. It must end well."""
    given = None
    piped = re.fullmatch(r"echo '(.*)' \| (.*)", line)
    if piped:
        given, line = piped[1] + "\n", piped[2]
    line, _, target = line.partition(" > ")
    words = shlex.split(quicker(line))
    result = command(*words[1:], given=given)
    assert result.exit_code == 0, f"{line}\n{result.output}"
    if target:
        Path(target.strip()).write_text(result.stdout)


def yaml_kind(content: dict[str, Any]) -> str:
    """Which schema a YAML of the documentation is held against."""
    return "tuning" if "pictures" in content or "experiments" in content else "experiment"


def write_world(folder: Path, boards: Path) -> None:
    """The files that the documentation names.

    boards: pictures of a chessboard.
    """
    (folder / "experiments").symlink_to(ROOT / "experiments")
    shutil.copytree(ROOT / "examples", folder / "examples")
    for name in ("my_graph.py", "my_evidence.py", "my_detector.py"):
        shutil.copy(ROOT / "examples" / name, folder)
    write_drive(folder, 600)
    shutil.copy(folder / "lines.csv", folder / "drive.csv")
    for name in ("long.parquet", "drive.mcap"):
        write_lines(folder / name, read_lines(folder / "lines.csv"))
    head, rows = (folder / "lines.csv").read_text().split("\n", 1)
    assert head.startswith("frame_id,line,offset_m,")
    others = head.replace("frame_id,line,offset_m", "frame,id,lateral")
    (folder / "other.csv").write_text(f"{others}\n{rows}")
    rows = ['monday,1,"[0, 600]",sun', 'tuesday,2,"[0, 600]",rain']
    table = ["name,recording.seed,recording.frames,tag.weather", *rows]
    (folder / "drives.csv").write_text("\n".join(table) + "\n")
    rewritten(ROOT / "experiments/quickstart.yaml", folder / "X.yaml", name="X")
    rows = (ROOT / "experiments/paper/recordings.csv").read_text().splitlines(keepends=True)
    (folder / "examples/two_runs.csv").write_text("".join([rows[0], rows[1], rows[6]]))
    log = simulate("quickstart", seed=3, frames=300, n_lanes=4).log
    write_rosbag(folder / "drive.bag", log, topics=(TOPICS[0], "/lanes"))
    foreign_table(folder / "foreign.csv")
    polynomials_table(folder / "polynomials.csv")
    own_bag(folder / "own.bag")
    offsets = np.array([-5.55, -1.85, 1.85, 5.55])
    seen = [draw_road(TRUE, offsets + 0.02 * k, 0.0, k) for k in range(16)]
    write_video(folder / "drive.avi", seen)
    (folder / "drive.avi").rename(folder / "drive.mp4")
    write_images(folder / "camera_bag", seen)
    write_camera(folder / "cam.yaml", TRUE)
    network = write_top_hat(folder, TRUE.width, TRUE.height)
    for name in ("lanes.yaml", "road.yaml"):
        shutil.copy(network, folder / name)
    # A network that sees nothing.
    blind = {"pred_logits": np.zeros((1, 7, 2)), "pred_curves": np.zeros((1, 7, 8))}
    (folder / "models").mkdir()
    for name in ("mine.onnx", "lstr_360x640.onnx", "models/lstr_360x640.onnx"):
        write_known(folder / name, blind, (640, 360), {"input_mask": (1, 1, 360, 640)})
    (folder / "boards").mkdir()
    (folder / "road").mkdir()
    for k, image in enumerate(seen[:3]):
        cv2.imwrite(str(folder / "road" / f"{k}.jpg"), image)
    for file in boards.glob("*.png"):
        cv2.imwrite(str(folder / "boards" / f"{file.stem}.jpg"), cv2.imread(str(file)))
    tusimple(folder / "tusimple_labels.json", [entry(k) for k in range(12)])
    write_positions(folder)


def write_positions(folder: Path) -> None:
    """roads.osm.pbf, and a drive over its longest motorway: drive.gpx, positions.csv.
    Without the real map nothing."""
    source = Path(os.environ.get("EGOLANE_DATA", "")) / "maps" / "bautzen_A4.osm"
    if not os.environ.get("EGOLANE_DATA") or not source.is_file():
        return
    import osmium

    writer = osmium.SimpleWriter(str(folder / "roads.osm.pbf"))
    longest: list[tuple[float, float]] = []
    for each in osmium.FileProcessor(str(source)).with_locations():
        writer.add(each)
        if each.is_way() and each.tags.get("highway") == "motorway":
            nodes = [(n.lat, n.lon) for n in each.nodes if n.location.valid()]
            longest = max(longest, nodes, key=len)
    writer.close()
    points = np.array(longest)
    step = np.hypot(*(np.diff(points, axis=0) * [111_200, 69_700]).T)
    along = np.concatenate([[0], np.cumsum(step)])
    at = np.arange(0, along[-1], 30.0)
    places = np.stack([np.interp(at, along, points[:, k]) for k in (0, 1)], axis=1)
    rows = [f"{t},{lat:.7f},{lon:.7f}" for t, (lat, lon) in enumerate(places)]
    (folder / "positions.csv").write_text("t_s,lat_gps,longitude\n" + "\n".join(rows) + "\n")
    stamps = "".join(
        f'<trkpt lat="{lat:.7f}" lon="{lon:.7f}">'
        f"<time>2024-01-01T00:{t // 60:02d}:{t % 60:02d}Z</time></trkpt>"
        for t, (lat, lon) in enumerate(places)
    )
    (folder / "drive.gpx").write_text(
        '<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
        f"{stamps}</trkseg></trk></gpx>"
    )
