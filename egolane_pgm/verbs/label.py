"""The verb `label`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Ge, Le

from egolane_pgm.drive import name_of
from egolane_pgm.experiment import Given, Overrides
from egolane_pgm.labelling import BELOW, Labels, label_experiment
from egolane_pgm.results import check_writable
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import ColumnNames, Detector, Lines, Option, StrPath, Truth, path_of
from egolane_pgm.verbs.run import ZERO_LABEL, choose, read_of

EXAMPLES = ("egolane label drive/lines.csv --n-lanes 4 --out labels",)


def label(
    recording: Lines | None = None,
    *,
    n_lanes: int | None = None,
    experiment: Annotated[Given | None, Option("X.yaml", said=ZERO_LABEL)] = None,
    overrides: Overrides = (),
    below: Annotated[float, Ge(0), Le(1)] = BELOW,
    ground_truth: Annotated[Truth | None, Option("FILE|none")] = None,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    detector: Detector = None,
    columns: ColumnNames = None,
    out: Annotated[
        StrPath | None, Option("DIR", default="results/*_labels", said="results/NAME_labels")
    ] = None,
) -> Labels:
    """Label the lanes of a RECORDING, and list the segments in which a label is not sure.

    The labels are made from the whole recording (smoothed beliefs, lane width of all frames), and
    no label is needed for that. labels.txt in the output folder is a ground-truth file as `egolane
    run --ground-truth` reads it; segments.csv lists the segments. Without RECORDING the
    experiment's own is labelled.

    - recording: lines, as `run` takes them; by default the experiment's own.
    - n_lanes: number of lanes of the road; needed without an experiment.
    - experiment: what labels it. Its filter is replaced by the smoother, and a causal lane width by
      that of all frames.
    - overrides: override a key of the experiment, e.g. recording.frame_rate=25.
    - below: labels with a smaller probability are not sure.
    - ground_truth: annotation to score the labels with.
    - camera: its camera: for pictures, lines in pixels.
    - detector: what looks at the video.
    - columns: what a table or messages call our columns, as for `run`.
    - out: folder of the labels. A `*` in it is the recording's name.

    Returns the `Labels`. Without `out` nothing is written. Raises InputError, one line, for
    whatever does not fit.

    >>> import tempfile
    >>> import egolane_pgm as ego
    >>> found = ego.label(experiment="zero_label", overrides={"recording.frames": [0, 600]})
    >>> found  # of a simulated drive
    Labels('zero_label': 600 frames, 3 lanes, ... segments not sure (...), accuracy 0.99...)
    >>> found.truth
    LaneTruth('labels': 600 frames, ids 0 to 599, ... crossing)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     saved = found.save(f"{folder}/mine")
    ...     print((saved / "labels.txt").read_text()[:5])
    0;3;0
    """
    if experiment is None and (recording is None or n_lanes is None):
        missing = "a recording" if recording is None else "how many lanes its road has, n_lanes"
        raise InputError(f"label: needs {missing}, or an experiment that says it")
    given = ZERO_LABEL if experiment is None else experiment
    chosen = choose(
        given, overrides, recording, ground_truth, n_lanes, camera, detector, columns=columns
    )
    place = None
    if out is not None:
        name = name_of(str(experiment)) if recording is None else chosen.name
        place = Path(path_of(out, "out").replace("*", name))
        check_writable(place)
    labels = label_experiment(chosen, below, read=read_of(chosen, recording, ground_truth))
    if place is not None:
        labels.save(place)
    return labels


def says(done: Labels, given: Mapping[str, Any]) -> str:
    """Where the labels are."""
    recording = given.get("recording")
    name = name_of(str(given["experiment"])) if recording is None else done.run.experiment.name
    return f"labels: {Path(given['out'].replace('*', name)) / 'labels.txt'}"
