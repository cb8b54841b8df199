"""The paper's ten runs against its 20 published confusion matrices."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from egolane_pgm.experiment import Experiment
from egolane_pgm.loading import experiments_folder, load_experiment
from egolane_pgm.result import Result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.confusion import frames_off
from egolane_pgm.tools.files import read_yaml
from egolane_pgm.types import InputError

PARAMETER_SETS = ("recovered", "published")

#: Detector and model, and their keys in published.yaml.
_SIDES = {"detector": "detector_only", "model": "model"}


def load_published() -> dict[int, dict[str, Any]]:
    """The published matrices, metrics and parameters per run number."""
    content = read_yaml(experiments_folder() / "paper" / "published.yaml", "runs: []")
    return {entry["run"]: entry for entry in content["runs"]}


def paper_experiment(run: int) -> Path:
    """The YAML of one of the paper's runs. Raises InputError for an unknown number."""
    found = sorted((experiments_folder() / "paper").glob(f"run{run:02d}_*.yaml"))
    if not found:
        raise InputError(f"run {run}: the paper has runs 1 to 10")
    return found[0]


#: Runs of the paper: `"1-3,7"`, a number, or several.
Runs = str | int | Sequence[int]


def parse_runs(given: Runs) -> list[int]:
    """Run numbers: `"1-3,7"` gives [1, 2, 3, 7]. Raises InputError for an unknown run."""
    runs: list[int] = []
    for part in given.split(",") if isinstance(given, str) else np.atleast_1d(given):
        match = re.fullmatch(r"\s*(\d+)(?:-(\d+))?\s*", str(part))
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if low > high:
            raise InputError(f"runs: {given}: write numbers and ranges, e.g. 1-5,7")
        runs += range(low, min(high, 99) + 1)
    for number in runs:
        paper_experiment(number)
    return list(dict.fromkeys(runs))


def parameters_for(entry: Mapping[str, Any], which: str) -> dict[str, Any]:
    """The parameters of one of the paper's runs.

    - entry: the run's part of published.yaml.
    - which: `published` for the values as printed, or `recovered` for values that give the
      published model matrix (run 5: from the authors' code; the others: searched).
    """
    if which not in PARAMETER_SETS:
        raise InputError(f"parameters: {which} is not one of {', '.join(PARAMETER_SETS)}")
    return dict(entry["parameters"] if which == "published" else entry["recovered"]["parameters"])


class Reproduced(NamedTuple):
    """One run of the paper: its entry in published.yaml, our result, and the frames off."""

    number: int
    entry: Mapping[str, Any]
    run: Result
    detector_frames_off: int
    model_frames_off: int


def reproduce_run(number: int, which: str) -> Reproduced:
    """Run one of the paper's experiments and compare it with the published matrices."""
    entry = load_published()[number]
    experiment = load_experiment(paper_experiment(number))
    experiment = experiment.model_copy(update={"parameters": parameters_for(entry, which)})
    run = run_experiment(experiment)
    off = [
        frames_off(np.asarray(run.scores[side]["confusion"]), np.asarray(entry[key]["confusion"]))
        for side, key in _SIDES.items()
    ]
    return Reproduced(number, entry, run, *off)


@dataclass(frozen=True, repr=False)
class Reproduction:
    """Some runs of the paper; iterating gives their results.

    - parameters: recovered or published.
    """

    runs: Sequence[Reproduced]
    parameters: str

    def __len__(self) -> int:
        return len(self.runs)

    def __iter__(self) -> Iterator[Result]:
        return (each.run for each in self.runs)

    def __repr__(self) -> str:
        numbers = ", ".join(str(each.number) for each in self.runs)
        return f"Reproduction(runs {numbers}: {self.summary}; {self.parameters}, in-sample)"

    @property
    def frames_off(self) -> int:
        """Frames that differ from the published matrices, of detectors and model."""
        return sum(each.detector_frames_off + each.model_frames_off for each in self.runs)

    @property
    def summary(self) -> str:
        """How many of the classified frames differ."""
        classified = sum(2 * each.run.scores["frames_scored"] for each in self.runs)
        return f"{self.frames_off} of {classified} classified frames off"

    def table(self) -> pd.DataFrame:
        """A row per run and matrix: frames off, each score, and the score in the paper."""
        rows = []
        for each in self.runs:
            for side, key in _SIDES.items():
                row = {"run": each.number, "matrix": side}
                row["frames_off"] = getattr(each, f"{side}_frames_off")
                for name, printed in each.entry[key]["metrics"].items():
                    row |= {name: each.run.scores[side][name], f"{name}_in_paper": printed}
                rows.append(row)
        return pd.DataFrame(rows).set_index(["run", "matrix"])

    @property
    def document(self) -> dict[str, Any]:
        """Unrounded scores of each run, ready for JSON."""
        rows = [
            {
                "run": each.number,
                "name": each.run.name,
                "tuned_on": each.run.run["tuned_on"],
                "detector_frames_off": each.detector_frames_off,
                "model_frames_off": each.model_frames_off,
                **{side: each.run.scores[side] for side in _SIDES},
            }
            for each in self.runs
        ]
        return {"parameters": self.parameters, "runs": rows, "total_frames_off": self.frames_off}


def known_parameters(experiment: Experiment) -> list[dict[str, Any]]:
    """The recovered and the published parameters, if an experiment is one of the paper's runs."""
    match = re.fullmatch(r"run(\d\d)_(italy|spain)_[a-z]+", experiment.name)
    if match is None or not 1 <= int(match[1]) <= 10:
        return []
    entry = load_published()[int(match[1])]
    return [parameters_for(entry, which) for which in PARAMETER_SETS]
