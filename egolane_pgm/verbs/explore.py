"""The verb `explore`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from annotated_types import Ge

from egolane_pgm.loading import ExperimentLike
from egolane_pgm.studies.explore import Exploration, candidates, make_problem
from egolane_pgm.studies.explore import explore as search
from egolane_pgm.studies.structures import parse_edge
from egolane_pgm.studies.study import block_folds
from egolane_pgm.tools import options
from egolane_pgm.tools.options import Option, StrPath, place_of
from egolane_pgm.types import InputError
from egolane_pgm.verbs.studied import open_studied

EXAMPLES = (
    "egolane explore experiments/paper/run01_italy_ml.yaml --jobs 2",
    "egolane explore X.yaml --judge bic --edge 'Lane -> WOR' --edge 'WOR repeats itself'",
)


def explore(
    experiments: Annotated[ExperimentLike | Sequence[Any], Option("EXPERIMENT...")],
    *,
    graph: options.Graph = None,
    overrides: options.Overrides = (),
    judge: Literal["log_loss", "accuracy", "log_evidence", "bic"] = "log_loss",
    edge: Annotated[Sequence[str], Option("EDGE")] = (),
    node: Annotated[Sequence[str], Option("NAME=SIZE")] = (),
    most_parents: Annotated[int, Ge(1)] = 3,
    trials: Annotated[int, Ge(0)] = 0,
    searches: Annotated[int, Ge(1)] = 1,
    folds: options.Folds = None,
    out: Annotated[StrPath | None, Option("DIR", default="results/exploring/*")] = None,
    jobs: options.Jobs = 1,
    cluster: options.Cluster = None,
) -> Exploration:
    """Search the edges of a graph: which one helps?

    Each graph is fitted by EM (`fit.labels`, `fit.strength`). First each edge is tried alone, then
    the best set of edges is searched.

    - experiments: one, or a list: experiments or results, of the same number of lanes.
    - graph: the graph to start from: a name or a file; in Python also a module or a pgmpy network.
    - overrides: override a key of the YAML, e.g. fit.labels=false.
    - judge: log_loss or accuracy of Lane, or log_evidence of the lines, in held-out frames; or bic.
    - edge: a candidate, e.g. 'Lane(t-1) -> WOR'; by default all that can be compiled. Repeatable.
    - node: a hidden node to add, e.g. Occlusion=2. Repeatable.
    - most_parents: parents that a node may get.
    - trials: 0 for a greedy search, else trials of an Optuna study with each edge on or off.
    - searches: number of searches, each with another seed of the new edges.
    - folds: number of blocks of each drive, by default 5, 0 for none.
    - out: directory of the answer. A `*` in it is the experiment's name.
    - jobs: processes that share the graphs.
    - cluster: Dask cluster for the graphs.

    Returns an `Exploration`; a repeated call with the same `out` goes on. Writes files only with
    `out`. Raises InputError for an edge or node that is not there and for drives that do not fit.

    >>> import egolane_pgm as ego
    >>> experiment = ego.load_experiment("quickstart", {"recording.frames": [0, 600]})
    >>> found = ego.explore(experiment, edge=["WOR repeats itself", "Lane -> WOR"], folds=2)
    >>> found.edges.columns[:3].tolist()
    ['edge', 'change', 'gain']
    """
    name, inputs = open_studied(experiments, overrides, graph)
    drives = [drive for each in inputs for drive in each.drives()]
    n_folds = inputs[0].experiment.fit.folds if folds is None else folds
    nodes = []
    for text in node:
        added, equals, size = text.partition("=")
        if not equals or not size.isdecimal():
            raise InputError(f"node: '{text}' is not NAME=SIZE, e.g. Occlusion=2")
        nodes.append((added.strip(), int(size)))
    problem = make_problem(
        drives, block_folds(drives, n_folds) if n_folds else (), judge=judge, nodes=nodes
    )
    known = list(dict.fromkeys(table.node[0] for table in problem.tables))
    edges = [parse_edge(each, known) for each in edge] or candidates(problem, most_parents)
    return search(
        problem,
        edges,
        trials=trials,
        searches=searches,
        most_parents=most_parents,
        directory=place_of(out, name),
        jobs=jobs,
        cluster=cluster,
    )


def summary(done: Exploration, given: Any) -> str:
    """The path of the best graph."""
    return f"best graph: {done.directory}/best.graph.yaml; run it with --graph"
