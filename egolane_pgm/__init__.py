"""Ego-lane estimation with sensor failure modelling.

    import egolane_pgm as ego

    run = ego.run("experiments/quickstart.yaml", overrides={"parameters.sigma1": 0.3})
    frame = run.to_pandas()
    run.plot()

Everything is imported when it is used first, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

#: The module of each public name.
_PUBLIC = {
    "experiments_folder": "paper",
    "load_experiment": "experiment",
    "run": "api.runs",
    "tune": "api.studies",
    "learn": "api.learned",
    "compare": "api.comparisons",
    "reproduce": "api.reproduction",
    "detect": "api.detections",
    "load_result": "api.loaded",
    "compile": "inference.compile",
    "draw_network": "api.networks",
    "RunResult": "api.runs",
    "RunResults": "api.runs",
    "TuneResult": "api.studies",
    "LearnResult": "api.learned",
    "CompareResult": "api.comparisons",
    "ReproduceResult": "api.reproduction",
    "DetectResult": "api.detections",
    "filter_beliefs": "inference.filtering",
    "smooth_beliefs": "inference.smoothing",
    "unrolled": "inference.unrolling",
    "fit_tables": "learning.em",
    "LineLog": "types",
    "LaneTruth": "types",
    "Evidence": "types",
    "Beliefs": "types",
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
