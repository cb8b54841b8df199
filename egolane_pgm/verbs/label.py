"""The verb `label`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from annotated_types import Ge, Le

from egolane_pgm.labelling import BELOW, Labels, label_input
from egolane_pgm.loading import ExperimentLike
from egolane_pgm.recordings.columns import column_keys
from egolane_pgm.result import check_writable
from egolane_pgm.runs import open_input
from egolane_pgm.tools import options
from egolane_pgm.tools.options import Option, StrPath, place_of

EXAMPLES = ("egolane label drive/lines.csv --n-lanes 4 --out labels",)


def label(
    given: Annotated[ExperimentLike | options.Lines, Option("EXPERIMENT|LINES")],
    *,
    experiment: Annotated[ExperimentLike | None, Option("X.yaml")] = None,
    n_lanes: int | None = None,
    overrides: options.Overrides = (),
    below: Annotated[float, Ge(0), Le(1)] = BELOW,
    ground_truth: Annotated[options.Truth | None, Option("FILE|none")] = None,
    columns: options.ColumnNames = None,
    out: Annotated[StrPath | None, Option("DIR", default="results/*_labels")] = None,
) -> Labels:
    """Label the lanes of a recording, and list the segments in which labels are uncertain.

    The labels come from the whole recording: smoothed posteriors, and a lane width estimated from
    all frames. No annotation is needed. labels.txt in the output folder is a ground-truth file for
    `egolane run --ground-truth`; segments.csv lists the uncertain segments.

    - given: an experiment, or lines, as `run` takes them.
    - experiment: the model for LINES, by default zero_label. Its filter is replaced with the
      smoother.
    - n_lanes: number of lanes of the road.
    - overrides: override a key of the experiment, e.g. recording.frame_rate=25.
    - below: labels with a smaller probability are uncertain.
    - ground_truth: annotation to score the labels with.
    - columns: names and units of a table's columns, as for `run`.
    - out: folder of the labels. A `*` in it is the experiment's name.

    Returns the `Labels`; writes them only with `out`. Raises InputError if the arguments do not
    fit.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> found = ego.label("zero_label", overrides={"recording.frames": [0, 600]})
    >>> found  # of a simulated drive
    Labels('zero_label': 600 frames, 3 lanes, ... uncertain segments (...), accuracy 0.99...)
    >>> found.truth["true_lane"].head(2).to_list()
    [3, 3]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     saved = found.save(f"{folder}/mine")
    ...     print((saved / "labels.txt").read_text()[:5])
    0;3;0
    """
    chosen = open_input(
        given,
        experiment=experiment,
        overrides=overrides,
        n_lanes=n_lanes,
        ground_truth=ground_truth,
        recording={"columns": column_keys(columns or {})},
    )
    place = place_of(out, chosen.experiment.name)
    if place is not None:
        check_writable(place)
    labels = label_input(chosen, below)
    if place is not None:
        labels.save(place)
    return labels


def summary(done: Labels, given: Mapping[str, Any]) -> str:
    """The path of the labels."""
    return f"labels: {place_of(given['out'], done.run.name)}/labels.txt"
