"""Ego-lane estimation with sensor failure modelling.

    import egolane_pgm as ego

    run = ego.run("experiments/quickstart.yaml", overrides={"parameters.sigma1": 0.3})
    frames = run.frames
    run.plot()

Everything is imported when it is used first, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What editors and type checkers see of the names below.
    from egolane_pgm.checking import check as check
    from egolane_pgm.checking import prediction_calibration as prediction_calibration
    from egolane_pgm.graphs import cpds as cpds
    from egolane_pgm.inference.compile import compile as compile
    from egolane_pgm.inference.events import lane_events as lane_events
    from egolane_pgm.inference.expected_counts import expected_counts as expected_counts
    from egolane_pgm.inference.filtering import filter_beliefs as filter_beliefs
    from egolane_pgm.inference.gradient import log_loss_gradient as log_loss_gradient
    from egolane_pgm.inference.sampling import posterior_paths as posterior_paths
    from egolane_pgm.inference.sampling import predicted as predicted
    from egolane_pgm.inference.sampling import sample as sample
    from egolane_pgm.inference.smoothing import fixed_lag_beliefs as fixed_lag_beliefs
    from egolane_pgm.inference.smoothing import smooth_beliefs as smooth_beliefs
    from egolane_pgm.inference.unrolling import unrolled as unrolled
    from egolane_pgm.inference.viterbi import viterbi as viterbi
    from egolane_pgm.labelling import Labels as Labels
    from egolane_pgm.loading import experiments_folder as experiments_folder
    from egolane_pgm.loading import load_experiment as load_experiment
    from egolane_pgm.parameters import Parameter as Parameter
    from egolane_pgm.recordings import read_lines as read_lines
    from egolane_pgm.result import Result as Result
    from egolane_pgm.result import load_result as load_result
    from egolane_pgm.runs import run as run
    from egolane_pgm.simulation import simulate as simulate
    from egolane_pgm.studies.em import fit_tables as fit_tables
    from egolane_pgm.studies.study import Study as Study
    from egolane_pgm.types import Beliefs as Beliefs
    from egolane_pgm.types import Evidence as Evidence
    from egolane_pgm.types import InputError as InputError
    from egolane_pgm.types import LineLog as LineLog
    from egolane_pgm.verbs.compare import compare as compare
    from egolane_pgm.verbs.detect import detect as detect
    from egolane_pgm.verbs.explore import explore as explore
    from egolane_pgm.verbs.label import label as label
    from egolane_pgm.verbs.learn import learn as learn
    from egolane_pgm.verbs.reproduce import reproduce as reproduce
    from egolane_pgm.verbs.tune import tune as tune
    from egolane_pgm.views.heat_maps import draw_tables as draw_tables
    from egolane_pgm.views.network import draw_network as draw_network

__version__ = "0.2.0"

#: The module of each public name.
_PUBLIC = {
    "experiments_folder": "loading",
    "load_experiment": "loading",
    "run": "runs",
    "tune": "verbs.tune",
    "learn": "verbs.learn",
    "explore": "verbs.explore",
    "compare": "verbs.compare",
    "reproduce": "verbs.reproduce",
    "detect": "verbs.detect",
    "label": "verbs.label",
    "simulate": "simulation",
    "read_lines": "recordings",
    "Parameter": "parameters",
    "cpds": "graphs",
    "load_result": "result",
    "compile": "inference.compile",
    "draw_network": "views.network",
    "draw_tables": "views.heat_maps",
    "Result": "result",
    "Study": "studies.study",
    "Labels": "labelling",
    "filter_beliefs": "inference.filtering",
    "smooth_beliefs": "inference.smoothing",
    "fixed_lag_beliefs": "inference.smoothing",
    "viterbi": "inference.viterbi",
    "sample": "inference.sampling",
    "posterior_paths": "inference.sampling",
    "predicted": "inference.sampling",
    "check": "checking",
    "prediction_calibration": "checking",
    "expected_counts": "inference.expected_counts",
    "log_loss_gradient": "inference.gradient",
    "lane_events": "inference.events",
    "unrolled": "inference.unrolling",
    "fit_tables": "studies.em",
    "LineLog": "types",
    "Evidence": "types",
    "Beliefs": "types",
    "InputError": "types",
}

__all__ = list(_PUBLIC)


def __getattr__(name: str) -> Any:
    module = _PUBLIC.get(name)
    if module is None:
        raise AttributeError(f"module 'egolane_pgm' has no attribute '{name}'")
    if name == "cpds":
        found: Any = import_module(f"egolane_pgm.{module}.{name}")
    else:
        found = getattr(import_module(f"egolane_pgm.{module}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
