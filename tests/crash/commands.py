"""The commands that are killed, what they are given, and what a reader finds in what they leave."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna

from egolane_pgm.cli.main import egolane
from egolane_pgm.recordings import read_lines
from egolane_pgm.report.study_trials import quiet
from egolane_pgm.results import is_result, read_result
from egolane_pgm.tools.files import clear_once, read_parquet, read_yaml
from egolane_pgm.tuning.storage import JOURNAL_NAME, open_storage
from tests.kits.drives import rewritten, write_drive
from tests.kits.synthetic_road import write_place
from tests.kits.tuning_kit import BLOCKS, QUICKSTART

DATABASE = "study.db"

#: What SQLite and Optuna have beside a study while they write; who opens the study puts it right.
_PASSING = (f"{DATABASE}-journal", f"{JOURNAL_NAME}.lock")

#: Keys that tell a time.
_TIMES = ("created", "seconds", "microseconds_per_frame")

#: Times, and the random ids of a page.
_PASSING_TEXT = re.compile(rb"\d{4}-\d\d-\d\dT[\d:]{8}|[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")

#: Files that hold studies.
STUDIES = (JOURNAL_NAME, DATABASE)


@dataclass(frozen=True)
class Command:
    """A command line, in which GIVEN and WORK stand for two folders.

    - before: one that wrote to the same place earlier; "" where a place is begun.
    - is_search: a search draws a trial anew that was at work; what it had finished it keeps.
    """

    words: str
    before: str = ""
    is_search: bool = False


_TUNE = f"tune {QUICKSTART} --trials 2 --jobs 1 --out WORK"


def _replaced(words: str) -> Command:
    """A command on GIVEN/a, after the same on GIVEN/b."""
    return Command(words, words.replace("/a/", "/b/").replace("_a", "_b"))


COMMANDS = {
    "run": _replaced("run GIVEN/a/experiment.yaml --out WORK/result --json WORK/said.json"),
    "run --fleet": Command("run GIVEN/a/experiment.yaml --fleet GIVEN/fleet.csv --out WORK"),
    "tune": Command(f"{_TUNE} --in-sample-only", is_search=True),
    "tune, held out": Command(f"{_TUNE} --blocks {BLOCKS} --no-figures", is_search=True),
    "tune --storage": Command(
        f"{_TUNE} --in-sample-only --no-figures --storage sqlite:///WORK/{DATABASE}",
        is_search=True,
    ),
    "compare": _replaced(
        "compare GIVEN/a/experiment.yaml GIVEN/a/other.yaml --blocks 2 --trials 2 --out WORK/kept"
        " --figure WORK/figure.png"
    ),
    "learn": _replaced("learn GIVEN/a/experiment.yaml --blocks 2 --out WORK/learned.yaml"),
    "convert .bag": _replaced("convert GIVEN/a/lines.csv WORK/lines.bag"),
    "convert .mcap": _replaced("convert GIVEN/a/lines.csv WORK/lines.mcap"),
    "detect": Command(
        "detect GIVEN/seen/drive.avi --camera GIVEN/seen/cam.yaml -o WORK/lines.parquet",
        "convert GIVEN/b/lines.csv WORK/lines.parquet",
    ),
    "video": Command(
        "video GIVEN/seen/drive.avi --camera GIVEN/seen/cam.yaml --n-lanes 2 -o WORK/drive.mp4",
    ),
    "report": _replaced("report GIVEN/result_a -o WORK/report.html"),
    "export .mcap": _replaced("export GIVEN/result_a WORK/drive.mcap"),
}


def write_given(folder: Path) -> None:
    """What the commands read."""
    for name, frames in (("a", 150), ("b", 120)):
        drive = write_drive(folder / name, frames)
        rewritten(drive, drive.with_name("other.yaml"), name="other", parameters__sigma1=0.5)
        run(f"run GIVEN/{name}/experiment.yaml --out GIVEN/result_{name}", folder, folder)
    rows = [f"{name}/lines.csv,{name}/ground_truth.txt,{name}" for name in "ab"]
    (folder / "fleet.csv").write_text("\n".join(["recording,ground_truth,name", *rows]) + "\n")
    (folder / "seen").mkdir()
    write_place(folder / "seen")


def run(words: str, given: Path, work: Path) -> None:
    """Do a command; SystemExit where it does not end well."""
    tempfile.tempdir = str(work / "tmp") if (work / "tmp").is_dir() else None
    # A process of its own has cleared nothing yet.
    clear_once.cache_clear()
    placed = [
        word.replace("GIVEN", str(given)).replace("WORK", str(work)) for word in words.split()
    ]
    code = egolane(placed, prog_name="egolane", standalone_mode=False)
    if code:
        raise SystemExit(code)


def found(folder: Path) -> dict[str, Any]:
    """What readers find in each file below a folder, by name, times left out.

    Raises InputError, or whatever a reader raises, for a file that is not whole.
    """
    contents: dict[str, Any] = {}
    for name in sorted(names(folder)):
        file = folder / name
        if any(part.startswith(".") for part in Path(name).parts):
            continue
        if file.is_dir():
            if is_result(file):
                read_result(file)
        elif not name.endswith(_PASSING):
            contents[name] = _content(file)
    return contents


def names(folder: Path) -> set[str]:
    """All that is below a folder, by name, hidden or not."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def _content(file: Path) -> Any:
    if file.suffix == ".json":
        return _timeless(json.loads(file.read_text()))
    if file.name in STUDIES:
        return _trials(file)
    if file.suffix == ".parquet":
        return _timeless(read_parquet(file).to_pydict())
    if file.suffix == ".yaml":
        return read_yaml(file, "a: 1")
    if file.name.startswith("lines."):
        return read_lines(file).offset_m.tobytes()
    return _PASSING_TEXT.sub(b"", file.read_bytes())


def _timeless(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {k: _timeless(v) for k, v in content.items() if k not in _TIMES}
    return [_timeless(v) for v in content] if isinstance(content, list) else content


def _trials(file: Path) -> Any:
    """The complete trials of each study."""
    is_journal = file.name == JOURNAL_NAME
    storage = open_storage(None if is_journal else f"sqlite:///{file}", file.parent)
    with quiet():
        studies = [
            optuna.load_study(study_name=s.study_name, storage=storage)
            for s in storage.get_all_studies()
        ]
    return {
        study.study_name: [
            (trial.number, trial.params, trial.values)
            for trial in study.get_trials(deepcopy=False)
            if trial.state == optuna.trial.TrialState.COMPLETE
        ]
        for study in studies
    }
