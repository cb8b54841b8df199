"""Reading back what was saved: `load_result`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from egolane_pgm.api.comparisons import is_comparison, read_comparison
from egolane_pgm.api.given import path_of
from egolane_pgm.api.runs import RunResults
from egolane_pgm.api.studies import TuneResult, read_study
from egolane_pgm.report.study_trials import is_study
from egolane_pgm.results import is_result, read_result
from egolane_pgm.types import InputError


def load_result(directory: str | os.PathLike[str]) -> Any:
    """Read what `run`, `tune` or `compare` saved, or the commands wrote.

    - directory: a result directory; or a folder of several of one kind.

    Returns what the verb returned: a `Result`, a `TuneResult` or a `CompareResult`. Raises
    InputError, naming the directory, where it is none of these, or damaged.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     saved = run.save(f"{folder}/mine", figures=False)
    ...     again = ego.load_result(saved)
    >>> again
    Result('quickstart': 300 frames, accuracy 0.877, detector 0.558; not tuned, causal)
    >>> again.to_pandas().equals(run.to_pandas())
    True
    """
    place = Path(path_of(directory, "load_result"))
    if is_result(place):
        return read_result(place)
    if is_study(place):
        return read_study(place)
    if is_comparison(place):
        return read_comparison(place)
    children = sorted(place.iterdir()) if place.is_dir() else []
    runs = [child for child in children if is_result(child)]
    if runs:
        return RunResults(tuple(map(read_result, runs)))
    searched = [read_study(child) for child in children if is_study(child)]
    if searched:
        files = {name: found for each in searched for name, found in each.files.items()}
        return TuneResult(tuple(each.documents[0] for each in searched), files)
    if not place.exists():
        raise InputError(f"{directory}: is not there")
    raise InputError(f"{directory}: is not a result directory of run, tune or compare")
