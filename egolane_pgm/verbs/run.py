"""The verb `run`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from egolane_pgm.result import Result
from egolane_pgm.runs import run as run

EXAMPLES = (
    "egolane run lines.csv --n-lanes 4",
    "egolane run drive.mp4 --n-lanes 3",
    "egolane run experiments/quickstart.yaml --set parameters.sigma1=0.3",
    "egolane run drive/lines.csv --experiment experiments/zero_label.yaml --n-lanes 4 --out mine",
    "egolane run experiments/quickstart.yaml --table runs.csv --out results/runs",
    "egolane run drive/experiment.yaml --dry-run",
)


def text(done: pd.DataFrame | str, style: str) -> str:
    """The output for a table of runs, or for a dry run."""
    from egolane_pgm.views.result_text import runs_text

    return done if isinstance(done, str) else runs_text(done, style)


def summary(done: Result | pd.DataFrame, given: Mapping[str, Any]) -> str:
    """The paths of the results."""
    if isinstance(done, Result):
        picture = Path(str(done.directory)) / "figures" / "strips.png"
        return f"result: {done.directory}" + f"; picture: {picture}" * picture.is_file()
    good = int(done["error"].isna().sum())
    there = int(done["was_there"].fillna(False).sum())
    return f"results: {good} of {len(done)} in {given['out']}, {there} were there"
