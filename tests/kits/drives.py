"""Files of a short simulated drive, and the command line run in this process."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from click.testing import CliRunner, Result

from egolane_pgm.command import egolane
from egolane_pgm.experiment import Experiment, make_experiment
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.recordings.table import write_table
from egolane_pgm.result import Result as Ran
from egolane_pgm.runs import open_input, run_input
from egolane_pgm.simulation import SimulatedDrive, simulate
from egolane_pgm.types import LineLog

N_FRAMES = 150

#: Frames that a recording lacks; none of them first or last.
GAPS = (20, 21, 22, 60)


@functools.cache
def short_drive(n_frames: int = N_FRAMES) -> SimulatedDrive:
    return simulate("quickstart", seed=3, frames=n_frames)


def log_with_gaps(n_frames: int = N_FRAMES) -> LineLog:
    """The drive without the frames of GAPS."""
    log = short_drive(n_frames).log
    return log.take(~np.isin(log.frame_id, GAPS))


def write_drive(folder: Path, n_frames: int = N_FRAMES, **changes: Any) -> Path:
    """lines.csv, ground_truth.txt and the experiment.yaml that is returned. changes: keys of the
    YAML, `recording__lri` for a key below a section; None takes a key out."""
    drive = short_drive(n_frames)
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "lines.csv", drive.log)
    write_ground_truth(folder / "ground_truth.txt", drive.truth)
    return write_experiment(folder / "experiment.yaml", n_lanes=drive.n_lanes, **changes)


def write_experiment(path: Path, **changes: Any) -> Path:
    content: dict[str, Any] = {
        "name": "drive",
        "recording": {"path": "lines.csv"},
        "ground_truth": {"path": "ground_truth.txt"},
        "n_lanes": 3,
        "tuned_on": "not_tuned",
    }
    path.write_text(yaml.safe_dump(with_changes(content, changes), sort_keys=False))
    return path


def rewritten(source: Path, target: Path, **changes: Any) -> Path:
    """The YAML of `source` with changes, as those of `write_drive`, at `target`."""
    content = with_changes(yaml.safe_load(source.read_text()), changes)
    target.write_text(yaml.safe_dump(content, sort_keys=False))
    return target


def with_changes(content: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`content` itself, changed: `recording__lri` is a key below a section, None takes one out."""
    for key, value in changes.items():
        *above, last = key.split("__")
        section = content
        for part in above:
            section = section.setdefault(part, {})
        if value is None:
            section.pop(last, None)
        else:
            section[last] = value
    return content


def run(
    given: Any, overrides: Any = None, *, chunk_frames: int | None = None, **options: Any
) -> Ran:
    """Run an experiment; options as `open_input` takes them."""
    opened = open_input(given, overrides=overrides, **options)
    return run_input(opened, chunk_frames=chunk_frames)


def command(*words: object, given: str | bytes | None = None) -> Result:
    """`egolane words...`, which must not end in a traceback. given: what it reads as input."""
    result = CliRunner().invoke(egolane, [str(word) for word in words], input=given)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def done(*words: object) -> Result:
    """`egolane words...`, which must end well."""
    result = command(*words)
    assert result.exit_code == 0, result.output
    return result


def run_json(drive: Path, folder: Path, *words: object) -> dict[str, object]:
    """What `--json` says of `egolane run` with these words."""
    target = folder / "run.json"
    done("run", drive, "--no-figures", "--out", folder / "out", "--json", target, *words)
    content = json.loads(target.read_text())
    assert isinstance(content, dict)
    return content


def refused(*words: object, given: str | None = None) -> str:
    """What `egolane words...` says on standard error: exit code 2 and one line, nothing else."""
    result = command(*words, given=given)
    assert result.exit_code == 2, (result.exit_code, result.output)
    (line,) = result.stderr.splitlines()
    assert line.startswith("egolane: "), line
    assert result.stdout == ""
    return line.removeprefix("egolane: ")


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, byte by byte; hidden ones too."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def simulated(name: str = "a", **keys: Any) -> Experiment:
    """An experiment on the simulated drive of two minutes."""
    content = {"name": name, "recording": {"simulate": "quickstart"}, "n_lanes": 4, **keys}
    return make_experiment(content, f"{name}.yaml")


def geometry(name: str = "geometry", **keys: Any) -> Experiment:
    """Position in lane, small."""
    parameters = {"cells": 4, "motion_bins": 9}
    keys = {"graph": "position_in_lane", "filter": "exact", "parameters": parameters, **keys}
    return simulated(name, evidence="line_geometry", **keys)
