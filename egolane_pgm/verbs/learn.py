"""The verb `learn`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from egolane_pgm.loading import ExperimentLike, Overrides
from egolane_pgm.studies.study import Study, run_study
from egolane_pgm.verbs.given import (
    ByTag,
    Cluster,
    Graph,
    HeldOutBlocks,
    Jobs,
    Lines,
    Option,
    Progress,
    StrPath,
    TableOfRuns,
    Truth,
)
from egolane_pgm.verbs.studied import open_studied, study_place
from egolane_pgm.verbs.studied import says as says

EXAMPLES = (
    "egolane learn drive/experiment.yaml",
    "egolane learn experiments/quickstart.yaml --set fit.labels=false",
)


def learn(
    experiments: Annotated[
        ExperimentLike | Lines | Sequence[Any], Option("EXPERIMENT...", many=True)
    ],
    *,
    n_lanes: int | None = None,
    ground_truth: Annotated[Truth | None, Option("FILE", hidden=True)] = None,
    graph: Graph = None,
    overrides: Overrides = (),
    out: Annotated[StrPath | None, Option("DIR", default="results/learning/*")] = None,
    blocks: Annotated[HeldOutBlocks | None, Option(said="5")] = None,
    table: TableOfRuns = None,
    by_tag: ByTag = None,
    jobs: Jobs = 1,
    cluster: Cluster = None,
    progress: Progress = None,
) -> Study:
    """Fit a model to its recording; write the fitted experiment and its held-out scores.

    An evidence rule that can learn (line_geometry) learns its parameters from the labels; with any
    other the tables of the graph are learned by EM, from lines and labels, or from lines alone
    (fit.labels=false). Each block is scored with a fit to the frames of the other blocks.

    - experiments: one, or a list: experiments, results, or lines.
    - n_lanes: number of lanes of the road.
    - ground_truth: a DataFrame with frame_id, lane and crossing, or a file.
    - graph: another graph; in Python also a module or a pgmpy network.
    - overrides: override a key of the YAML, e.g. fit.labels=false.
    - out: directory of the study. A `*` in it is the experiment's name.
    - blocks: blocks held out in turn, 0 for none; of a table parts of its drives.
    - table: table of runs: columns are YAML keys (recording.path, n_lanes) and tag.X.
    - by_tag: with a table: hold out the drives with each value of tag.NAME in turn.
    - jobs: processes that share the fits.
    - cluster: Dask cluster for the fits.
    - progress: whether a bar is shown; None for in a terminal.

    Returns a `Study`: `network` is the learned graph in pgmpy. Without `out` nothing is written.
    Raises InputError if nothing can be learned.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 600]})
    >>> study = ego.learn(experiment, overrides={"fit.labels": False}, blocks=2)
    >>> study.held_out
    Result('quickstart': 600 frames, accuracy 0.880 ...; held out, causal)
    >>> sorted(study.fitted)[:1]
    ['tables.DetectorOutput']
    """
    given = open_studied(
        experiments,
        overrides=overrides,
        n_lanes=n_lanes,
        ground_truth=ground_truth,
        graph=graph,
        table=table,
        by_tag=by_tag,
        blocks=blocks,
    )
    return run_study(
        given.drives,
        "learn",
        given.folds,
        name=given.name,
        experiments=given.experiments,
        directory=study_place(out, given),
        notes=given.notes,
        jobs=jobs,
        cluster=cluster,
        progress=progress,
    )
