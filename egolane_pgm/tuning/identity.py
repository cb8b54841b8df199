"""What makes two studies the same one, so that none goes on with trials of another."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from egolane_pgm.drive import Drive, data_entries
from egolane_pgm.experiment import resolved
from egolane_pgm.plugins import OWN_FILES, source_files
from egolane_pgm.tools.files import plain
from egolane_pgm.tuning.objective import detector_of
from egolane_pgm.tuning.plan import Problem
from egolane_pgm.tuning.space import SearchSpace, describe
from egolane_pgm.vision.detectors import networks, simple
from egolane_pgm.vision.detectors.runner import Detector, own_files


def identity_of(problem: Problem) -> dict[str, Any]:
    """Describe a study as JSON: recordings by checksum, search space, code of graph and evidence
    rule by checksum, objective, sampler and seed. The number of trials may grow."""
    recordings = {}
    for drive in problem.drives:
        content = resolved(drive.experiment, {})
        kept = ("n_lanes", "evidence", "graph", "filter", "evidence_reading", "unassigned_below")
        recordings[drive.experiment.name] = {
            **{key: content[key] for key in kept},
            "recording": {k: v for k, v in content["recording"].items() if k != "path"},
            "data": [
                entry["sha256"][:16]
                for entry in data_entries(drive.experiment, drive.recorded.files)
            ],
            "code": _code(drive),
        }
    names = [drive.experiment.name for drive in problem.drives]
    more: dict[str, Any] = {"recordings": recordings}
    if problem.plan.fleet is not None:
        more["frames_of_all_drives_alike"] = True
    return search_identity(problem, dict(zip(names, problem.spaces, strict=True)), more)


def search_identity(
    problem: Any, spaces: Mapping[str, SearchSpace], more: Mapping[str, Any]
) -> dict[str, Any]:
    """Describe a search as JSON, as far as searches on recordings and on pictures are alike.

    - problem: with its `plan`, `settings` and `space`.
    - spaces: the search space of each thing that is searched on, by name.
    - more: further keys.
    """
    identity = {
        "name": problem.plan.name,
        "objective": list(problem.settings.objectives),
        "sampler": problem.settings.sampler,
        "seed": problem.settings.seed,
        "from_scratch": problem.plan.tuning.from_scratch,
        "space": {
            "searched": describe(problem.space)["searched"],
            "fixed": {name: describe(space)["fixed"] for name, space in spaces.items()},
        },
        **more,
    }
    return dict(json.loads(json.dumps(plain(identity))))


def _code(drive: Drive) -> dict[str, str]:
    """The checksums of the code of graph, evidence rule and detector, and of a reader
    that is a file of its own."""
    experiment = drive.experiment
    files = {
        "graph": source_files(drive.model.graph),
        "evidence": source_files(drive.model.rule),
    }
    recording = experiment.recording
    if recording.format is not None and recording.format.endswith(OWN_FILES):
        files["format"] = [experiment.folder / recording.format]
    if recording.detector is not None:
        files["detector"] = _files_of(detector_of(experiment))
    return {kind: _checksum(mine) for kind, mine in files.items()}


def code_of_detector(detector: Detector) -> str:
    """The checksum of a detector's code, and of a network that it looks through."""
    return _checksum(_files_of(detector))


def _files_of(detector: Detector) -> list[Path]:
    files = source_files(detector.module)
    if not detector.name.endswith(OWN_FILES):
        files = [*files, *source_files(simple), *source_files(networks)]
    return files + own_files(detector)


def _checksum(files: Sequence[Path]) -> str:
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
