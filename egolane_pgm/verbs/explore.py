"""The verb `explore`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from egolane_pgm.loading import ExperimentLike
from egolane_pgm.studies.explore import Exploration, make_problem
from egolane_pgm.studies.explore import explore as search
from egolane_pgm.studies.study import block_folds
from egolane_pgm.tools import options
from egolane_pgm.tools.options import Option, StrPath, place_of
from egolane_pgm.verbs.studied import open_studied
from egolane_pgm.views.studies import exploration_text

EXAMPLES = (
    "egolane explore experiments/paper/run01_italy_ml.yaml --jobs 2",
    "egolane explore X.yaml --judge bic --edge 'Lane -> WOR' --edge 'WOR repeats itself'",
)


def explore(
    experiments: Annotated[ExperimentLike | Sequence[Any], Option("EXPERIMENT...")],
    *,
    graph: options.Graph = None,
    ground_truth: options.TruthInMemory = None,
    n_lanes: options.LanesInMemory = None,
    overrides: options.Overrides = (),
    judge: Annotated[str | None, Option("SCORE")] = None,
    edge: Annotated[Sequence[str], Option("EDGE")] = (),
    node: Annotated[Sequence[str], Option("NAME=SIZE")] = (),
    out: Annotated[StrPath | None, Option("DIR", default="results/exploring/*")] = None,
    jobs: options.Jobs = 1,
    cluster: options.Cluster = None,
) -> Exploration:
    """Search the edges of a graph: which one helps the answer, or is in the data?

    Which edge helps: each graph is fitted to the labels and judged by the lanes of held-out blocks
    (`fit.folds`); the default with labels. Which edge is in the data: each graph is fitted by EM
    and judged by BIC (`judge=bic`, or `fit.objective=log_evidence`). First each edge is tried
    alone, then the best set is searched: greedily, or with `fit.trials` by an Optuna study
    (`fit.sampler`) with a switch per edge. A gain counts if it is larger than what chance gives the
    best of all candidates.

    - experiments: one, or a list: experiments, results, studies or lines, of the same number of
      lanes.
    - graph: the graph to start from: a name or a file; in Python also a module or a pgmpy network.
    - ground_truth, n_lanes: of lines in memory, as for `run`; of several a list of ground truths.
    - overrides: override a key of the YAML, e.g. fit.strength=30.
    - judge: the score to improve in held-out frames: log_loss, accuracy or another one of Lane, or
      log_evidence of the lines; or bic of all frames. By default log_loss, or bic if
      `fit.objective` is log_evidence.
    - edge: a candidate, e.g. 'Lane(t-1) -> WOR'; by default all that can be compiled. Repeatable.
    - node: a hidden node to add, e.g. Occlusion=2. Repeatable.
    - out: directory of the results. A `*` in it is the experiment's name.
    - jobs: processes that share the fits.
    - cluster: Dask cluster for the fits.

    Returns an `Exploration`; a repeated call with the same `out` reuses its fits. Writes files only
    with `out`. Raises InputError for an unknown edge or node, and for drives that do not fit.

    >>> import egolane_pgm as ego
    >>> changes = {"recording.frames": [0, 600], "fit.folds": 2}
    >>> experiment = ego.load_experiment("quickstart", changes)
    >>> found = ego.explore(experiment, edge=["WOR repeats itself", "Lane -> WOR"])
    >>> found.edges.columns[:3].tolist()
    ['edge', 'change', 'gain']
    """
    name, inputs = open_studied(experiments, overrides, graph, ground_truth, n_lanes)
    drives = [drive for each in inputs for drive in each.drives()]
    fit = inputs[0].experiment.fit
    place = place_of(out, name)
    folds = block_folds(drives, fit.folds)
    problem = make_problem(drives, folds, judge=judge, nodes=node, seed=fit.seed)
    found = search(
        problem, edge, trials=fit.trials or 0, sampler=fit.sampler,
        directory=place, jobs=jobs, cluster=cluster,
    )  # fmt: skip
    if place is not None:
        # Pictures are slow to import.
        from egolane_pgm.views.network import write_network

        write_network(found.model.compiled, place / "best.bif")
        write_network(found.model.compiled, place / "best.png", found.gains)
    return found


def text(done: Exploration, style: str = "markdown") -> str:
    """Which edge helps."""
    return exploration_text(done, style)


def summary(done: Exploration, given: Any) -> str:
    """The path of the best graph."""
    return f"best graph: {done.directory}/best.graph.yaml; run it with --graph"
