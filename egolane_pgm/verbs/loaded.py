"""Reading back what was saved: `load_result`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from egolane_pgm.comparing.result import is_comparison, read_comparison
from egolane_pgm.results import is_result, read_result
from egolane_pgm.running import OneOfSeveral
from egolane_pgm.tuning.result import Study, read_study
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import path_of
from egolane_pgm.verbs.run import table_of_runs
from egolane_pgm.views.study_trials import is_study


def load_result(directory: str | os.PathLike[str]) -> Any:
    """Read what `run`, `tune` or `compare` wrote.

    - directory: a result directory; or a folder of several of one kind.

    Returns what the verb returned: a `Result`, a `Study`, a `Comparison`, or a `DriveTable` of
    several results. Raises InputError, naming the directory, where it is none of these, or damaged.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> run = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     saved = run.save(f"{folder}/mine", figures=False)
    ...     again = ego.load_result(saved)
    >>> again
    Result('quickstart': 300 frames, accuracy 0.877, detector 0.558; not tuned, causal)
    >>> again.to_pandas().equals(run.to_pandas())
    True
    """
    place = Path(path_of(directory, "directory"))
    if is_result(place):
        return read_result(place)
    if is_study(place):
        return read_study(place)
    if is_comparison(place):
        return read_comparison(place)
    children = sorted(place.iterdir()) if place.is_dir() else []
    runs = [read_result(child) for child in children if is_result(child)]
    if runs:
        return table_of_runs(
            [OneOfSeveral(r.name, r.directory, r.experiment, scores=r.scores) for r in runs], place
        )
    searched = [read_study(child).studies[0] for child in children if is_study(child)]
    if searched:
        return Study(tuple(searched))
    if not place.exists():
        raise InputError(f"{directory}: is not there")
    raise InputError(f"{directory}: is not a result directory of run, tune or compare")
