"""The gradient, EM and the search of edges, by others on the same networks.

Compared are the gradient, the gain in log likelihood of each step, and BIC per frame with the
edges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pandas as pd

from egolane_pgm.graphs.cpds import dynamics, previous, prior, quiet, uniform, within
from egolane_pgm.inference.compile import Compiled, compile_tables
from egolane_pgm.inference.gradient import log_loss_gradient
from egolane_pgm.inference.sampling import sample
from egolane_pgm.runs import open_input
from egolane_pgm.studies.em import fit_tables
from egolane_pgm.studies.explore import explore, make_problem
from egolane_pgm.studies.structures import parse_edge, with_structure
from egolane_pgm.types import Evidence, FloatArray
from tests.benchmarks import peers
from tests.benchmarks.data import Data
from tests.benchmarks.timing import Row, duel

FRAMES = 10_000
STEPS = 20

#: By parent and child; 0 is the frame before. The network that is drawn from has the first three.
EDGES = {
    "WOR -> DetectorOutput": ("W1", "D1"),
    "WOR(t-1) -> WOR": ("W0", "W1"),
    "DetectorOutput(t-1) -> DetectorOutput": ("D0", "D1"),
    "WOR(t-1) -> DetectorOutput": ("W0", "D1"),
    "DetectorOutput(t-1) -> WOR": ("D0", "W1"),
}

#: What is measured, ours, others by a name that begins with the package, and the number of frames.
Part = tuple[str, Callable[[], FloatArray], Mapping[str, Callable[[], FloatArray]], int]


def workbench_rows(data: Data, rounds: int) -> Iterator[Row]:
    for what, ours, others, frames in (gradient(data), em(), search()):
        for name, run in others.items():
            there = find_spec(name.split(",")[0].lower())
            yield duel(what, ours, name, run if there else None, frames, max(3, rounds // 8))


def gradient(data: Data) -> Part:
    """The gradient of the log-loss of the lane by the logarithm of each entry of all tables."""
    lane = np.where(data.truth["is_crossing"], -1, data.truth["true_lane"] - 1).astype(np.int64)

    def ours() -> FloatArray:
        found = log_loss_gradient(data.compiled, data.evidence, {"Lane": lane})
        return np.concatenate([each.ravel() for each in found.gradient.values()])

    others = {"dynamax, jit of grad": peers.dynamax_gradient(data.compiled, data.evidence, lane)}
    return "gradient of the log-loss", ours, others, len(lane)


def em() -> Part:
    """The gain in log likelihood of each step, from random tables to those of random data."""
    draws = np.random.default_rng(0).dirichlet(np.ones(4), (2, 2, 4))

    def chain(moves: FloatArray, shown: FloatArray) -> Compiled:
        lane = [*prior("Lane", uniform(4)), *dynamics("Lane", [previous("Lane")], moves)]
        tables = [*lane, *within("Shown", ["Lane"], shown)]
        return compile_tables(tables, observed=("Shown",), hidden=("Lane",))

    truth, start = (chain(*each) for each in draws)
    shown = sample(truth, FRAMES, seed=0)[["Shown"]]
    evidence, symbols = Evidence.hard(shown, start), shown["Shown"].cat.codes.to_numpy(int)[:, None]
    given = start.prior[0], start.transition[0], start.groups[0].emission
    settings = {"init_params": "", "tol": -np.inf, "n_iter": STEPS, "implementation": "scaling"}

    def ours() -> FloatArray:
        fitted = fit_tables(start, evidence, strength=1e-9, iterations=STEPS)
        return np.diff(fitted.log_posterior[:STEPS])

    def by_hmmlearn() -> FloatArray:
        return np.diff(peers.hmmlearn_chain(given, **settings).fit(symbols).monitor_.history)

    return f"EM, {STEPS} steps, 4 states, {FRAMES:,} frames", ours, {"hmmlearn": by_hmmlearn}, 0


def search() -> Part:
    """BIC per frame, and whether each edge is found, of two observed nodes."""
    changes = {"recording.simulate": "a4", "recording.frames": [0, FRAMES], "fit.strength": 1e-9}
    [drive] = open_input("quickstart", overrides=changes).drives()
    problem, model = make_problem([drive], [], judge="bic"), drive.model.compiled
    lane = [*prior("Lane", uniform(4)), *dynamics("Lane", [previous("Lane")], uniform(4, 4))]
    start = [*lane, *within("WOR", [], uniform(2)), *within("DetectorOutput", [], uniform(4))]
    true = frozenset(parse_edge(each, model.values) for each in list(EDGES)[:3])
    n, rng = len(drive.log), np.random.default_rng(0)
    tables = [
        replace(t, values=rng.dirichlet(np.ones(t.values.shape[-1]), t.values.shape[:-1]))
        for t in with_structure(start, true, 0)[0]
    ]
    roles = {"observed": model.observed, "hidden": ("Lane",), "values": model.values}
    drawn = sample(compile_tables(tables, **roles), n, 0)[["DetectorOutput", "WOR"]]
    evidence = (Evidence.hard(drawn, model),)
    problem = replace(problem, tables=tuple(start), hidden=("Lane",), evidence=evidence)
    d, w = (drawn[name].cat.codes.astype(str).to_numpy() for name in drawn)
    pairs = pd.DataFrame({"D0": d[:-1], "D1": d[1:], "W0": w[:-1], "W1": w[1:]}, dtype="category")
    forbidden = [(a, b) for a in pairs for b in pairs if a != b and (a, b) not in EDGES.values()]

    def answer(edges: Any, score: Callable[[str, list[str]], float]) -> FloatArray:
        bic = sum(score(k, [a for a, b in edges if b == k]) for k in ("D1", "W1"))
        return np.array([bic / n, *(edge in edges for edge in EDGES.values())])

    def ours() -> FloatArray:
        found = explore(problem, list(EDGES))
        # Without the free numbers of Lane.
        bic = found.structures["bic"][0] + 4 * 3 / 2 * np.log(n)
        return answer([EDGES[str(edge)] for edge in found.best], lambda *_: bic / 2)

    def by_pgmpy() -> FloatArray:
        from pgmpy.estimators import BIC, ExpertKnowledge, HillClimbSearch

        with quiet():
            known = {"expert_knowledge": ExpertKnowledge(forbidden_edges=forbidden)}
            dag = HillClimbSearch(pairs).estimate("bic-d", show_progress=False, **known)
            return answer(list(dag.edges()), BIC(pairs).local_score)

    def by_pyagrum() -> FloatArray:
        import pyagrum

        learner = pyagrum.BNLearner(pairs)
        learner.useScoreBIC().useNoPrior().useGreedyHillClimbing()
        for edge in forbidden:
            learner.addForbiddenArc(*edge)
        bn = learner.learnBN()
        edges = [tuple(bn.variable(node).name() for node in arc) for arc in bn.arcs()]
        # Its logarithms are those of 2.
        return answer(edges, lambda *family: learner.score(*family) * np.log(2))

    others = {"pgmpy": by_pgmpy, "pyAgrum": by_pyagrum}
    return f"search of {len(EDGES)} edges by BIC, {n:,} frames", ours, others, 0
