"""Several graphs side by side on the paper's recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.comparing.graphs import named_graphs, with_graph
from egolane_pgm.drive import load_recording
from egolane_pgm.experiment import load_experiment
from egolane_pgm.model import prepare_model
from egolane_pgm.paper import load_published, paper_experiment, parameters_for
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.running import run_experiment
from egolane_pgm.types import all_problems


def compare_graphs(number: int, graphs: Sequence[str], which: str = "recovered") -> dict[str, Any]:
    """Run one of the paper's runs under each graph, with the paper's parameters as far as the graph
    has them. Nothing is tuned for the other graphs, and the paper's values are in-sample.

    graphs: as `graphs.named_graphs` takes them.

    Returns `run`, its number; `scores`, per graph, and for "detector", as `score_with_intervals`
    gives them; and `mean_log_evidence` per graph.

    Raises InputError for all graphs that cannot be used, before anything is read.
    """
    experiment = load_experiment(paper_experiment(number))
    parameters = parameters_for(load_published()[number], which)
    named = named_graphs(graphs)
    models = {name: with_graph(experiment, graph, parameters) for name, graph in named.items()}
    with all_problems() as part:
        for model in models.values():
            with part():
                prepare_model(model)
    recorded = load_recording(experiment)
    scores: dict[str, Mapping[str, Any]] = {}
    log_evidence: dict[str, float] = {}
    for name, model in models.items():
        run = run_experiment(model, recorded=recorded)
        if "detector" in run.scores:
            scores.setdefault("detector", run.scores["detector"])
        scores[name] = run.scores["model"]
        log_evidence[name] = run.beliefs.mean_log_evidence
    return {"run": number, "scores": scores, "mean_log_evidence": log_evidence}


def compare_rows(document: Mapping[str, Any], key: str) -> tuple[list[str], list[list[str]]]:
    """Header and rows: one score, a row per run, a column per graph and one for the detector.

    document: as `compare_json` makes it.
    """
    runs = document["runs"]
    names = list(runs[0]["scores"])
    rows = [[str(r["run"]), *(f"{r['scores'][name][key]:.3f}" for name in names)] for r in runs]
    return ["run", *names], rows


def compare_json(runs: Sequence[Mapping[str, Any]], which: str) -> dict[str, Any]:
    """What `egolane compare --json` writes, from what `compare_graphs` returns for each run."""
    return {
        "schema_version": SCHEMA_VERSION,
        "parameters": which,
        "tuned_on": "same_frames",
        "runs": list(runs),
    }
