"""Ego-lane estimation with sensor failure modelling.

`load_experiment`, `run_experiment` and the containers of `egolane_pgm.types` do the main job;
they are imported on first use, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_PUBLIC = {
    "load_experiment": "egolane_pgm.experiment",
    "run_experiment": "egolane_pgm.running",
    "LineLog": "egolane_pgm.types",
    "LaneTruth": "egolane_pgm.types",
    "Evidence": "egolane_pgm.types",
    "Beliefs": "egolane_pgm.types",
    "InputError": "egolane_pgm.types",
}

__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'egolane_pgm' has no attribute '{name}'")
