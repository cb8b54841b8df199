"""The paper's ten runs against its 20 published confusion matrices, and the search for the
parameters behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.files import read_text, read_yaml, write_text
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.loading import Recorded, load_recording
from egolane_pgm.model import Model, make_evidence, prepare_model, with_parameters
from egolane_pgm.run import Run, run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import confusion, frames_off
from egolane_pgm.types import Evidence, InputError, IntArray

SCHEMA_VERSION = 1
SCORES = ("precision", "recall", "f1", "accuracy", "log_loss")
PARAMETER_SETS = ("recovered", "published")

#: The published parameters are truncated to three decimals: the value used was below this higher.
TRUNCATION = 0.001


def experiments_folder() -> Path:
    """The folder of the experiments that come with the package."""
    installed = Path(__file__).parent / "_experiments"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "experiments"


def published_path() -> Path:
    """The file with the published matrices and parameters."""
    return experiments_folder() / "paper" / "published.yaml"


def load_published(path: Path | None = None) -> dict[int, dict[str, Any]]:
    """The published matrices, metrics and parameters per run number."""
    content = read_yaml(path or published_path(), "runs: []")
    return {entry["run"]: entry for entry in content["runs"]}


def paper_experiment(run: int) -> Path:
    """The YAML of one of the paper's runs. Raises InputError for a number that is none."""
    found = sorted((experiments_folder() / "paper").glob(f"run{run:02d}_*.yaml"))
    if not found:
        raise InputError(f"run {run}: the paper has runs 1 to 10")
    return found[0]


def parse_runs(text: str) -> list[int]:
    """`"1-3,7"` -> [1, 2, 3, 7]. Raises InputError for anything else."""
    runs: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise InputError(f"--runs {text}: write numbers and ranges, e.g. 1-5,7")
        low, high = int(first), int(last or first)
        for run in (low, high):
            paper_experiment(run)
        if low > high:
            raise InputError(f"--runs {text}: {low}-{high} is an empty range")
        runs += range(low, high + 1)
    return list(dict.fromkeys(runs))


def parameters_for(entry: Mapping[str, Any], which: str) -> dict[str, Any]:
    """A run's parameters: `published` as printed, or `recovered`, which give the published model
    matrix. Those of run 5 stand in the authors' code, a search found the others."""
    if which not in PARAMETER_SETS:
        raise InputError(f"--parameters {which}: is not one of {', '.join(PARAMETER_SETS)}")
    return dict(entry["parameters"] if which == "published" else entry["recovered"]["parameters"])


@dataclass(frozen=True)
class Reproduced:
    """One run of the paper, ours beside theirs. run: number; entry: its part of published.yaml.
    detector_frames_off, model_frames_off: see `frames_off`."""

    number: int
    entry: Mapping[str, Any]
    run: Run
    detector_frames_off: int
    model_frames_off: int


def reproduce_run(number: int, which: str) -> Reproduced:
    """Run one of the paper's experiments and compare it with what was published."""
    entry = load_published()[number]
    experiment = load_experiment(paper_experiment(number))
    experiment = experiment.model_copy(update={"parameters": parameters_for(entry, which)})
    run = run_experiment(experiment)
    off = {
        kind: frames_off(
            np.asarray(run.scores[kind]["confusion"]), np.asarray(entry[theirs]["confusion"])
        )
        for kind, theirs in (("detector", "detector_only"), ("model", "model"))
    }
    return Reproduced(number, entry, run, off["detector"], off["model"])


def reproduce_json(runs: Iterable[Reproduced], which: str) -> dict[str, Any]:
    """What `egolane reproduce --json` writes: unrounded, keys as documented in the README."""
    rows = [
        {
            "run": r.number,
            "name": r.run.experiment.name,
            "tuned_on": r.run.experiment.tuned_on,
            "frames": len(r.run.beliefs),
            "frames_scored": r.run.scores["model"]["frames_scored"],
            "detector_frames_off": r.detector_frames_off,
            "model_frames_off": r.model_frames_off,
            **{
                kind: {key: r.run.scores[kind][key] for key in (*SCORES, "confusion")}
                for kind in ("detector", "model")
            },
        }
        for r in runs
    ]
    total = sum(r["detector_frames_off"] + r["model_frames_off"] for r in rows)
    return {
        "schema_version": SCHEMA_VERSION,
        "parameters": which,
        "runs": rows,
        "total_frames_off": total,
    }


def agrees(ours: float, printed: float) -> bool:
    """Tells whether a score, truncated to two digits as the paper does it, is the printed one."""
    return int(np.floor(ours * 100 + 1e-9)) == round(printed * 100)


@dataclass(frozen=True)
class Recovered:
    """What `recover` found. parameters: the best set. frames_off: of its model matrix.
    evaluations: how many sets were tried."""

    parameters: Mapping[str, float]
    frames_off: int
    evaluations: int


def recover(
    number: int,
    *,
    evaluations: int = 20_000,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Recovered:
    """Search the box [v, v + 0.001) of each published parameter for a set that gives the published
    model matrix: uniform in the box, and every other time around the best set so far.

    progress(evaluations so far, fewest frames off) is called now and then.
    """
    entry = load_published()[number]
    experiment = load_experiment(paper_experiment(number))
    searched = [name for name in entry["parameters"] if name != "bonus_value"]
    low = np.array([entry["parameters"][name] for name in searched])
    evaluate = _model_matrix(experiment)
    target = np.asarray(entry["model"]["confusion"])
    rng = np.random.default_rng(seed)
    best = low
    best_off = frames_off(evaluate(dict(zip(searched, low, strict=True))), target)
    done = 1
    while best_off > 0 and done < evaluations:
        if done % 2:
            values = low + TRUNCATION * rng.random(len(low))
        else:
            width = TRUNCATION * 10 ** rng.uniform(-2, -0.5)
            values = np.clip(best + width * rng.standard_normal(len(low)), low, low + TRUNCATION)
            values = np.minimum(values, np.nextafter(low + TRUNCATION, low))
        off = frames_off(evaluate(dict(zip(searched, values, strict=True))), target)
        done += 1
        if off < best_off or (off == best_off and done % 2):
            best, best_off = values, off
        if progress is not None and done % 100 == 0:
            progress(done, best_off)
    found = {name: float(v) for name, v in zip(searched, best, strict=True)}
    parameters = {**found, "bonus_value": entry["parameters"]["bonus_value"]}
    return Recovered(parameters, best_off, done)


def _model_matrix(experiment: Experiment) -> Callable[[Mapping[str, float]], IntArray]:
    """A function from graph parameters to the model's confusion matrix; the evidence is made once,
    since only the graph's parameters vary."""
    model: Model = prepare_model(experiment)
    recorded: Recorded = load_recording(experiment)
    evidence: Evidence = make_evidence(model, recorded.log, experiment.evidence_reading).filtered
    truth = recorded.truth
    assert truth is not None

    def evaluate(parameters: Mapping[str, float]) -> IntArray:
        changed = with_parameters(model, {**model.parameters, **parameters})
        beliefs = filter_beliefs(changed.compiled, evidence, experiment.filter)
        assigned = assigned_lane(beliefs.lane)[recorded.scored]
        return confusion(assigned, truth.lane, truth.is_crossing, experiment.n_lanes)

    return evaluate


def store_recovered(number: int, found: Recovered, how: str, path: Path | None = None) -> None:
    """Put what was found under `recovered` of the run in published.yaml, the rest as it was."""
    path = path or published_path()
    lines = read_text(path).splitlines()
    start = next(i for i, text in enumerate(lines) if text.strip() == f"- run: {number}")
    end = next(
        (i for i in range(start + 1, len(lines)) if lines[i].lstrip().startswith("- run:")),
        len(lines),
    )
    block = _without_recovered(lines[start:end])
    block += [
        "    recovered:",
        f"      parameters: {{{', '.join(f'{k}: {v!r}' for k, v in found.parameters.items())}}}",
        f"      frames_off: {found.frames_off}",
        f"      evaluations: {found.evaluations}",
        f"      how: {how}",
    ]
    text = "\n".join([*lines[:start], *block, *lines[end:]]) + "\n"
    write_text(path, text)


def _without_recovered(block: Sequence[str]) -> list[str]:
    if "    recovered:" not in block:
        return list(block)
    return list(block[: list(block).index("    recovered:")])
