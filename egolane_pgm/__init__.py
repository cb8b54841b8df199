"""Ego-lane estimation with sensor failure modelling.

    import egolane_pgm as ego

    run = ego.run("experiments/quickstart.yaml", overrides={"parameters.sigma1": 0.3})
    frame = run.to_pandas()
    run.plot()

Everything is imported when it is used first, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    # What editors and type checkers see of the names below.
    from egolane_pgm.api.comparisons import CompareResult as CompareResult
    from egolane_pgm.api.comparisons import compare as compare
    from egolane_pgm.api.detections import DetectResult as DetectResult
    from egolane_pgm.api.detections import detect as detect
    from egolane_pgm.api.fleets import FleetResult as FleetResult
    from egolane_pgm.api.fleets import run_fleet as run_fleet
    from egolane_pgm.api.labels import LabelResult as LabelResult
    from egolane_pgm.api.labels import label as label
    from egolane_pgm.api.learned import FleetLearnResult as FleetLearnResult
    from egolane_pgm.api.learned import LearnResult as LearnResult
    from egolane_pgm.api.learned import learn as learn
    from egolane_pgm.api.learned import learn_fleet as learn_fleet
    from egolane_pgm.api.loaded import load_result as load_result
    from egolane_pgm.api.networks import draw_network as draw_network
    from egolane_pgm.api.reproduction import ReproduceResult as ReproduceResult
    from egolane_pgm.api.reproduction import reproduce as reproduce
    from egolane_pgm.api.runs import RunResults as RunResults
    from egolane_pgm.api.runs import run as run
    from egolane_pgm.api.runs import run_streamed as run_streamed
    from egolane_pgm.api.studies import TuneResult as TuneResult
    from egolane_pgm.api.studies import tune as tune
    from egolane_pgm.experiment import experiments_folder as experiments_folder
    from egolane_pgm.experiment import load_experiment as load_experiment
    from egolane_pgm.inference.compile import compile as compile
    from egolane_pgm.inference.events import lane_events as lane_events
    from egolane_pgm.inference.filtering import filter_beliefs as filter_beliefs
    from egolane_pgm.inference.smoothing import smooth_beliefs as smooth_beliefs
    from egolane_pgm.inference.unrolling import unrolled as unrolled
    from egolane_pgm.learning.em import fit_tables as fit_tables
    from egolane_pgm.results import Result as Result
    from egolane_pgm.types import Beliefs as Beliefs
    from egolane_pgm.types import Evidence as Evidence
    from egolane_pgm.types import InputError as InputError
    from egolane_pgm.types import LaneEvents as LaneEvents
    from egolane_pgm.types import LaneTruth as LaneTruth
    from egolane_pgm.types import LineLog as LineLog

__version__ = "0.1.0"

#: The module of each public name.
_PUBLIC = {
    "experiments_folder": "experiment",
    "load_experiment": "experiment",
    "run": "api.runs",
    "run_fleet": "api.fleets",
    "run_streamed": "api.runs",
    "tune": "api.studies",
    "learn": "api.learned",
    "learn_fleet": "api.learned",
    "compare": "api.comparisons",
    "reproduce": "api.reproduction",
    "detect": "api.detections",
    "label": "api.labels",
    "load_result": "api.loaded",
    "compile": "inference.compile",
    "draw_network": "api.networks",
    "Result": "results",
    "RunResults": "api.runs",
    "FleetResult": "api.fleets",
    "TuneResult": "api.studies",
    "LearnResult": "api.learned",
    "FleetLearnResult": "api.learned",
    "CompareResult": "api.comparisons",
    "ReproduceResult": "api.reproduction",
    "DetectResult": "api.detections",
    "LabelResult": "api.labels",
    "filter_beliefs": "inference.filtering",
    "smooth_beliefs": "inference.smoothing",
    "lane_events": "inference.events",
    "unrolled": "inference.unrolling",
    "fit_tables": "learning.em",
    "LineLog": "types",
    "LaneTruth": "types",
    "Evidence": "types",
    "Beliefs": "types",
    "LaneEvents": "types",
    "InputError": "types",
}

__all__ = list(_PUBLIC)

#: What `run` was called before.
_OLD = {"run_experiment": "running"}


def __getattr__(name: str) -> Any:
    module = _PUBLIC.get(name) or _OLD.get(name)
    if module is None:
        raise AttributeError(f"module 'egolane_pgm' has no attribute '{name}'")
    return getattr(import_module(f"egolane_pgm.{module}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
