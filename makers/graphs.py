"""`python -m makers.graphs fits edges checks`: results/graphs, on the paper's ten recordings.

`fits` compares what the paper's graph is fitted to (ten minutes of one core), `edges` searches its
edges for each recording (half an hour), `checks` are the predictive checks of graphs with learned
tables (three minutes). The structures that were fitted are kept in results/runs. Needs
EGOLANE_DATA.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

import egolane_pgm as ego
from egolane_pgm.checking import Draws, Statistic, changes_per_hour, mean_run, share
from egolane_pgm.paper import paper_experiment
from egolane_pgm.runs import open_input
from egolane_pgm.scoring.bootstrap import bootstrap_interval
from egolane_pgm.scoring.confusion import log_loss_per_frame
from egolane_pgm.scoring.scores import mean
from egolane_pgm.studies.explore import Exploration, Tried, explore, make_problem
from egolane_pgm.studies.structures import Structure, edges_of, parse_edge, spelled
from egolane_pgm.studies.study import block_folds
from egolane_pgm.tools.files import write_text
from egolane_pgm.types import FloatArray
from egolane_pgm.views.style import INK, MODEL_COLOUR, new_figure, write_figure
from egolane_pgm.views.tables import page, table
from makers.pages import RESULTS, RUNS

PAGES = RESULTS / "graphs"

#: The candidates; the last two are edges of the paper's graph, which are taken away.
EDGES = [
    *("DetectorOutput(t-1) -> DetectorOutput", "DetectorOutput repeats itself"),
    *("WOR(t-1) -> WOR", "WOR repeats itself", "Lane -> WOR", "Lane -> SensorState"),
    *("Lane(t-1) -> DetectorOutput", "SensorState(t-1) -> DetectorOutput"),
    *("DetectorOutput(t-1) -> SensorState", "WOR -> DetectorOutput"),
    *("SensorState -> DetectorOutput", "SensorState -> WOR"),
]

#: Places of a road's runs among the ten.
ROADS = {"Italy": slice(0, 5), "Spain": slice(5, 10), "ten runs": slice(0, 10)}

#: Graphs whose predictions are checked.
CHECKED = ("sensor_failure", "wor_on_lane", "autoregressive", "sensor_dynamics", "no_wor")


def experiment(run: int) -> Any:
    """A run of the paper without frames of untrusted labels."""
    frames = {"recording.frames": [0, 9577]} if run > 5 else {}
    keys = {"filter": "exact", "parameters.bonus_value": 9, **frames}
    return ego.load_experiment(paper_experiment(run), keys)


#: The paper's graph with round numbers, and what it is fitted to.
DEFAULTS = {"sigma1": 0.4, "sigma2": 0.5, "p1": 0.9, "p2": 0.9, "p3": 0.6, "p4": 0.6}
FITS = {
    "defaults": {"fit.method": "none"},
    "search for accuracy, 200 trials": {"fit.method": "tune", "fit.trials": 200},
    "EM": {"fit.method": "learn", "fit.objective": "log_evidence"},
    "tables to the labels": {"fit.method": "learn"},
    "numbers to the labels": {"fit.method": "learn", "fit.learns": "parameters"},
}

#: The runs of line detectors on each road.
LINES = {"Italy": range(1, 5), "Spain": range(6, 10)}


def of_fit(run: int, **keys: Any) -> Any:
    """A run of the paper with the default parameters."""
    return ego.load_experiment(
        experiment(run), {"parameters": {"bonus_value": 9, **DEFAULTS}, **keys}
    )


def judged(frames: pd.DataFrame) -> FloatArray:
    """The log-loss and whether the lane is right in each frame, and whether it counts (K, 3)."""
    belief = frames.filter(regex=r"^Lane_\d+$").to_numpy()
    lane = frames["true_lane"].to_numpy(int)
    is_right = belief.argmax(axis=1) + 1 == lane
    values = [log_loss_per_frame(belief, lane), is_right, np.ones(len(lane))]
    return np.array(values).T * ~frames[["is_crossing"]].to_numpy(bool)


def fits() -> None:
    """Write fits.md: what the paper's graph is best fitted to, on unseen frames."""
    found: dict[str, dict[int, FloatArray]] = {}
    for name, keys in FITS.items():
        settings = {**keys, "fit.folds": 3}
        found[name] = {
            k: judged(ego.run(of_fit(k, **settings), held_out=True).frames) for k in range(1, 11)
        }
    other = found["numbers to the labels of the other road"] = {}
    for road, runs in LINES.items():
        study = ego.learn([of_fit(k, **FITS["numbers to the labels"]) for k in runs], folds=0)
        keys = {"parameters": {**study.experiment.parameters}}
        for k in LINES["Spain" if road == "Italy" else "Italy"]:
            other[k] = judged(ego.run(of_fit(k, **keys)).frames)
    rows: dict[str, dict[str, Any]] = {}
    for name, each in found.items():
        rows[name] = {}
        for column, score in enumerate(("log-loss", "accuracy")):
            mine, start = (
                [side[k][:, [column, 2]] for runs in LINES.values() for k in runs]
                for side in (each, found["defaults"])
            )
            change = bootstrap_interval(mine, mean, minus=start, seeds=[0] * 4 + [1] * 4)
            ends = {"": change.estimate, "_low": change.low, "_high": change.high}
            rows[name][score] = np.mean([mean(side.sum(axis=0)) for side in mine])
            rows[name] |= {f"change in {score}{end}": value for end, value in ends.items()}
    losses = {
        n: {k: mean(v[:, [0, 2]].sum(axis=0)) for k, v in r.items()} for n, r in found.items()
    }
    of_runs = pd.DataFrame(losses).T.rename_axis("log-loss of run").astype(float)
    of_fits = pd.DataFrame(rows).T.rename_axis("eight runs of line detectors")
    forms = {c: "+.3f" if c.startswith("change") else ".3f" for c in of_fits}
    parts = [
        "# What is the graph fitted to?\n\nMade by `make graphs`; [how](README.md#how).",
        page([table(of_fits, forms)], style="wide"),
        page([table(of_runs, dict.fromkeys(of_runs, ".3f"))], style="wide"),
    ]
    write_text(PAGES / "fits.md", "\n\n".join(parts) + "\n")


def searched(run: int) -> tuple[Exploration, Exploration, Tried]:
    """Search the edges of the graph on a run, by log-loss and by BIC; also return the fits."""
    drives, place = open_input(experiment(run)).drives(), RUNS / "edges" / f"run{run:02d}"
    problem = make_problem(drives, block_folds(drives, 3))
    bic = explore(make_problem(drives, (), judge="bic"), EDGES, directory=place / "bic")
    found = explore(problem, EDGES, directory=place)
    return found, bic, Tried(problem, place)


def gain_of(tried: Tried, structure: Structure) -> FloatArray:
    """The gain in held-out log-loss of each frame, and whether it counts (K, 2)."""
    tried([frozenset(), structure])
    (mine,), (start,) = (tried.summands(each) for each in (structure, frozenset()))
    return np.stack([start[:, 0] - mine[:, 0], mine[:, 1]], axis=1)


def edges() -> None:
    """Write edges.md and edges.png: which edge helps, by held-out log-loss and by BIC."""
    found_by, bic_by, runs = map(list, zip(*map(searched, range(1, 11)), strict=True))
    best, by_bic = ([one.best for one in several] for several in (found_by, bic_by))
    alone, of_bic = (
        [one.edges.set_index("edge") for one in several] for several in (found_by, bic_by)
    )
    problem = runs[0].problem
    nodes, there = [*problem.hidden, *problem.model.compiled.observed], edges_of(problem.tables)
    sets = {"own best set": best, "of the other road": best[5:] + best[:5], "best by BIC": by_bic}
    each, rows = {}, {}
    for name in [*EDGES, *sets]:
        structures = sets.get(name) or [frozenset({parse_edge(name, nodes)})] * 10
        label = name if name in sets else spelled(structures[0], there)
        gains = list(map(gain_of, runs, structures))
        each[label] = [gain[:, 0].sum() / gain[:, 1].sum() for gain in gains]
        row = rows[label] = {"helps in": sum(value > 0 for value in each[label])}
        for road, part in ROADS.items():
            # The runs of a road are one drive, which is resampled.
            seeds = ([0] * 5 + [1] * 5)[part]
            found = bootstrap_interval(gains[part], mean, seeds=seeds)
            row |= {road: found.estimate, f"{road}_low": found.low, f"{road}_high": found.high}
        if name in EDGES:
            row["passes in"] = sum(one.loc[name, "passes"] for one in alone)
            row["BIC"] = np.mean([one.loc[name, "gain"] for one in of_bic])
            row["passes by BIC in"] = sum(one.loc[name, "passes"] for one in of_bic)
            row["chosen by BIC in"] = sum(structures[0] <= one for one in by_bic)
    names = [f"{run} {paper_experiment(run).stem.split('_')[-1]}" for run in range(1, 11)]
    gained = pd.DataFrame(each, index=names).T.rename_axis("gain")
    found = pd.DataFrame(rows).T.rename_axis("edge or set")
    order = [*found["ten runs"][: len(EDGES)].sort_values(ascending=False).index, *sets]
    found, gained, n = found.loc[order], gained.loc[order], len(EDGES)
    write_figure(lambda: edges_figure(found[:n], gained[:n]), PAGES / "edges.png")
    forms = dict.fromkeys(found, 0) | dict.fromkeys([*ROADS, "BIC", *names], "+.3f")
    parts = [
        "# Which edge helps\n\nMade by `make graphs`; [how](README.md#how).",
        page([table(found, forms)], style="wide"),
        page([table(gained[n:], forms)], style="wide"),
        "\n".join(f"- {n}: {spelled(s, there)}." for n, s in zip(names, best, strict=True)),
    ]
    write_text(PAGES / "edges.md", "\n\n".join(parts) + "\n")


def edges_figure(found: pd.DataFrame, each: pd.DataFrame) -> Figure:
    """The gain of each edge: the mean of a road with its interval, and a mark per detector."""
    figure = new_figure(9.5, 4.6, "Gain of each edge alone in held-out log-loss, nats per frame")
    rows, ticks = np.arange(len(found)), [-0.3, -0.1, -0.03, 0, 0.03, 0.1, 0.3]
    for axes, road in zip(figure.subplots(1, 2, sharey=True), ROADS, strict=False):
        axes.axvline(0, color=INK, lw=0.8)
        ends = (found[f"{road}_{end}"] for end in ("low", "high"))
        axes.hlines(rows, *ends, MODEL_COLOUR, lw=5, alpha=0.4)
        axes.plot(found[road], rows, "|", color=MODEL_COLOUR, ms=11, mew=2.5, label="mean")
        for (name, values), mark in zip(each.iloc[:, ROADS[road]].items(), "os^vD", strict=True):
            axes.plot(values, rows, mark, color=INK, mfc="w", ms=4, label=f"run {name}")
        axes.set_xscale("symlog", linthresh=0.05)
        axes.set_xticks(ticks, [f"{x:+g}" if x else "0" for x in ticks])
        axes.set(title=road, yticks=rows, yticklabels=found.index)
        axes.legend(loc="lower right")
    axes.invert_yaxis()
    return figure


def failed(statistic: Any) -> Statistic:
    """A statistic of whether the sensor is not OK."""
    of = statistic("failed", 1)
    return lambda d: of(Draws({"failed": (d.values["SensorState"] != 0) * 1}, d.frame_rate))


def checked(run: int, graph: str | None) -> pd.Series:
    """The checks of a graph learned from a run, or of the paper's model; and for each observed node
    the mean distance between the probability of a value one frame ahead and how often it comes."""
    given = experiment(run)
    by_em = {"fit.objective": "log_evidence"}
    network = (
        ego.learn(given, graph=graph, folds=0, overrides=by_em).model.network if graph else None
    )
    result = ego.run(given, graph=network)
    of_sensor = {"share failed": failed(share), "mean failure, s": failed(mean_run)}
    statistics = {"changes per hour": changes_per_hour, **of_sensor}
    found = ego.check(result, statistics, n=300)[["truth", "posterior", "model"]].stack()
    bins = ego.prediction_calibration(result)
    off = (bins["predicted"] - bins["comes"]).abs() * bins["count"]
    off = off.groupby(bins["node"]).sum() / bins.groupby("node")["count"].sum()
    return pd.concat([found, off.set_axis([("predictions off by", node) for node in off.index])])


def checks() -> None:
    """Write checks.md: does the model look like the data?"""
    models = {"the paper's parameters": None, **{f"{graph}, learned": graph for graph in CHECKED}}
    parts = ["# Does the model look like the data?\n\nMade by `make graphs`; [how](README.md#how)."]
    for road in ("Italy", "Spain"):
        runs, means = range(1, 11)[ROADS[road]], {}
        for name, graph in models.items():
            means[name] = pd.concat([checked(run, graph) for run in runs], axis=1).mean(axis=1)
        # The first one has all statistics.
        found = pd.DataFrame(means, index=means["the paper's parameters"].index).T
        found = found.dropna(axis=1, how="all").rename_axis("graph")
        found.columns = [f"{name}: {of}" for name, of in found]
        digits = {name: 0 if "hour" in name else 2 for name in found}
        parts += [f"## {road}, mean of five runs", page([table(found, digits)], style="wide")]
    write_text(PAGES / "checks.md", "\n\n".join(parts) + "\n")


if __name__ == "__main__":
    for name in sys.argv[1:]:
        {"fits": fits, "edges": edges, "checks": checks}[name]()
