"""The verb `compare`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd

from egolane_pgm.comparing import compare as compare_results
from egolane_pgm.tools.options import Option, StrPath

EXAMPLES = (
    "egolane compare results/a results/b",
    "egolane compare results/runs --of graph --by tag.driver",
)


def compare(
    results: Annotated[Sequence[Any], Option("RESULT...")],
    *,
    of: Annotated[str | None, Option("KEY")] = None,
    by: Annotated[str | None, Option("KEY")] = None,
    detector: bool = False,
    out: Annotated[StrPath | None, Option("FILE.png")] = None,
) -> pd.DataFrame:
    """Compare results on the annotated frames of the same recordings, with paired intervals.

    - results: result directories, folders of them (as `run --table` writes), Results, or Studies,
      which count as their held-out results.
    - of: sides of the comparison: a key of the experiment (graph, parameters.sigma1), or tag.X. By
      default the name of each result; of several recordings the folder of their results.
    - by: a second such key: results with different values of it are compared separately.
    - detector: add the detectors' own answers.
    - out: draw accuracy with its intervals.

    Returns a row per side, with each score (the mean over the recordings), its 95 % interval, and
    the difference to the first side with a paired interval; recordings of one drive are resampled
    together. Columns `event_...` score the lane changes that are reported within 1 s. Raises
    InputError unless all sides have the same recordings.

    >>> import egolane_pgm as ego
    >>> short = {"recording.frames": [0, 800]}
    >>> one = ego.run("quickstart", overrides=short)
    >>> other = ego.run("quickstart", overrides={**short, "filter": "exact"})
    >>> ego.compare([one, other], of="filter")["accuracy"].round(3).to_dict()
    {'assumed_density': 0.836, 'exact': 0.832}
    """
    table = compare_results(results, of=of, by=by, detector=detector)
    if out is not None:
        from egolane_pgm.views.comparisons import comparison_figure
        from egolane_pgm.views.style import write_figure

        write_figure(lambda: comparison_figure(table), Path(out))
    return table


def text(done: pd.DataFrame, style: str) -> str:
    """The output of the command."""
    from egolane_pgm.views.comparisons import comparison_text

    return comparison_text(done, style)
