"""Draws from a network: drives of the model, paths of the posterior, and what is predicted.

A drive is drawn frame by frame from the tables (ancestral sampling). A path of the posterior is
drawn backwards from the beliefs of the exact filter (forward filtering, backward sampling:
Fruhwirth-Schnatter 1994), so that paths are distributed as P(hidden nodes of all frames |
evidence of all frames).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from egolane_pgm.inference.compile import Compiled, takes_any_model
from egolane_pgm.inference.filtering import joint_input
from egolane_pgm.inference.kernels.draws import draw_backward, draw_forward
from egolane_pgm.inference.smoothing import pass_forward
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray, Observed


@takes_any_model
def sample(
    compiled: Compiled,
    n_frames: int,
    seed: int,
    *,
    inputs: Mapping[str, Sequence[int] | IntArray] | None = None,
) -> pd.DataFrame:
    """Draw a drive from the model.

    - n_frames: number T of frames.
    - inputs: per input node the index of its value in each frame (T,).

    Returns a row per frame and a categorical column per node, with the names of its values.
    Observed nodes have a value, not soft evidence; `Evidence.hard` takes them. Raises InputError
    for inputs that are missing or do not fit.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> model = ego.run(place, overrides={"recording.frames": [0, 9]}).model
    >>> drive = ego.sample(model, 1000, seed=0)
    >>> list(drive)
    ['SensorState', 'Lane', 'DetectorOutput', 'WOR']
    >>> len(ego.Evidence.hard(drive[["DetectorOutput", "WOR"]], model.compiled))
    1000
    """
    rng = np.random.default_rng(seed)
    drawn = sampled_states(compiled, n_frames, 1, rng, inputs)[0]
    columns = {name: value[drawn] for name, value in compiled.node_value.items()}
    for group in compiled.groups:
        emission = group.emission.cumsum(axis=1)[drawn]
        goal = rng.random(n_frames)[:, None] * emission[:, -1:]
        shown, sizes = _nodes(compiled, group.observed)
        values = np.unravel_index((emission <= goal).sum(axis=1), sizes)
        columns |= dict(zip(shown, map(np.asarray, values), strict=True))
    for name in compiled.inputs:
        columns[name] = np.asarray((inputs or {})[name])
    return named_values(compiled, columns)


def named_values(
    compiled: Compiled, indices: Mapping[str, IntArray], index: pd.Index | None = None
) -> pd.DataFrame:
    """Return a path of states: a row per frame, a categorical column per node with its values.

    - indices: of the values of each node, lanes from 0; of several paths (n, T).
    - index: of the rows.
    """
    columns = {
        name: pd.Categorical.from_codes(np.ravel(codes), compiled.values[name])
        for name, codes in indices.items()
    }
    return pd.DataFrame(columns, index)


def sampled_states(
    compiled: Compiled,
    n_frames: int,
    n: int,
    rng: np.random.Generator,
    inputs: Mapping[str, Sequence[int] | IntArray] | None = None,
) -> IntArray:
    """Return n drives drawn from the model as joint states, (n, T)."""
    if n_frames < 1 or n < 1:
        raise InputError(f"sample: {min(n_frames, n)} is not a positive number")
    ones = {key: np.ones((n_frames, *_nodes(compiled, key)[1])) for key in compiled.observed}
    given = {name: np.asarray(index) for name, index in (inputs or {}).items()}
    index = joint_input(compiled, Evidence(ones, given))
    paths = np.empty((n, n_frames), dtype=np.int64)
    prior = compiled.prior.cumsum(axis=-1)
    transition = compiled.transition.cumsum(axis=-1)
    draw_forward(prior, transition, index, rng.random((n, n_frames)), paths)
    return paths


@takes_any_model
def posterior_paths(
    compiled: Compiled,
    evidence: Evidence,
    n: int,
    seed: int,
    *,
    is_first: BoolArray | None = None,
) -> pd.DataFrame:
    """Draw n paths from the posterior given the evidence of all T frames.

    - is_first (T,): True where a sequence begins; by default the first frame only.

    Returns a row per path and frame, its index, and a column per hidden node with the names of its
    values, as `sample`. Evidence that the filter flags as impossible is ignored. Raises InputError
    for evidence that does not fit.

    >>> import egolane_pgm as ego
    >>> run = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> paths = ego.posterior_paths(run.model, run.evidence, 1000, seed=0)
    >>> smoothed = ego.smooth_beliefs(run.model.compiled, run.evidence)
    >>> share = (paths["Lane"] == "1").groupby("frame").mean()
    >>> bool(abs(share - smoothed.lane[:, 0]).max() < 0.06)
    True
    """
    paths = drawn_paths(compiled, evidence, n, seed, is_first=is_first)
    ends = range(n), range(len(evidence))
    return named_values(compiled, paths, pd.MultiIndex.from_product(ends, names=["path", "frame"]))


def drawn_paths(
    compiled: Compiled,
    evidence: Evidence,
    n: int,
    seed: int,
    *,
    is_first: BoolArray | None = None,
) -> dict[str, IntArray]:
    """Return the index of the value of each hidden node in `posterior_paths`, (n, T)."""
    if n < 1:
        raise InputError(f"posterior_paths: n: {n} is not a positive number")
    passed = pass_forward(compiled, evidence, is_first=is_first)
    uniform = np.random.default_rng(seed).random((n, len(evidence)))
    paths = np.empty(uniform.shape, dtype=np.int64)
    draw_backward(
        passed.filtered, compiled.transition, passed.input_index, passed.begins, uniform, paths
    )
    return {name: compiled.node_value[name][paths] for name in compiled.hidden}


@takes_any_model
def predicted(
    compiled: Compiled, evidence: Evidence, *, is_first: BoolArray | None = None
) -> dict[str, FloatArray]:
    """Return P(observed node | evidence of earlier frames), before the node's own evidence.

    - is_first: as in `posterior_paths`.

    Returns for each observed node (T, cardinality). Raises InputError for evidence that does not
    fit.

    >>> import egolane_pgm as ego
    >>> run = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> ego.predicted(run.model, run.evidence)["WOR"].shape
    (300, 2)
    """
    passed = pass_forward(compiled, evidence, is_first=is_first)
    before = np.roll(passed.filtered, 1, axis=0)
    states = compiled.prior[passed.input_index]
    for u in range(len(compiled.transition)):
        rows = ~passed.begins & (passed.input_index == u)
        states[rows] = before[rows] @ compiled.transition[u]
    found: dict[str, FloatArray] = {}
    for group in compiled.groups:
        names, sizes = _nodes(compiled, group.observed)
        joint = (states @ group.emission).reshape(-1, *sizes)
        for k, name in enumerate(names):
            others = tuple(1 + j for j in range(len(sizes)) if j != k)
            found[name] = joint.sum(axis=others)
    return found


def _nodes(compiled: Compiled, key: Observed) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the nodes of a key of the evidence and their cardinalities."""
    names = (key,) if isinstance(key, str) else key
    return names, tuple(compiled.cardinality[name] for name in names)
