"""A result directory for each experiment of a comparison: what it was, and what it believed in each
block with parameters that have not seen it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from egolane_pgm.comparing.side import Side
from egolane_pgm.model import causality
from egolane_pgm.results import SCHEMA_VERSION, Result
from egolane_pgm.running import held_out_result
from egolane_pgm.tools.files import make_directory, write_json
from egolane_pgm.types import FloatArray

#: The file of a comparison's directory that has the numbers: of all recordings, and of each one.
DOCUMENT = "comparison.json"


def folder_of(title: str) -> str:
    """A recording's title as the name of a directory."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", title).strip("._-") or "recording"


def results_of(
    part: Mapping[str, Any], sides: Sequence[Sequence[Side]], tentative: FloatArray | None
) -> dict[str, Result]:
    """The result of each experiment of a recording, by its name; for several seeds one for each,
    `NAME_seed3`.

    part: the recording's part of the document.
    sides: per experiment one, or one for each seed of its search.
    tentative (K, n): what the detector alone answers, where it was looked at.
    """
    found = {}
    for alike, entry in zip(sides, part["experiments"], strict=True):
        for side in alike:
            run = {
                "blocks": part["blocks"],
                "parameters_per_block": [dict(found) for found in side.held_out.parameters],
                "tuned_on": side.tuned_on,
                **causality(side.experiment, side.drive.model, side.held_out.parameters),
            }
            suffix = f"_seed{side.seed}" if len(alike) > 1 else ""
            found[f"{side.experiment.name}{suffix}"] = held_out_result(
                replace(side.drive, experiment=side.experiment),
                side.beliefs,
                side.held_out.block,
                fit=side.experiment.fit,
                tentative=tentative,
                notes=side.notes,
                run=run,
                scores={"name": side.experiment.name, "held_out": entry},
            )
    return found


def save_recording(out: Path, part: Mapping[str, Any], results: Mapping[str, Result]) -> Path:
    """Write `out`/<recording>: comparison.json (the recording's part of the document) and a result
    directory for each experiment. Raises InputError where they cannot be written."""
    folder = out / folder_of(part["title"])
    make_directory(folder)
    for name, result in results.items():
        result.save(folder / name, figures=False)
    write_json(folder / DOCUMENT, {"schema_version": SCHEMA_VERSION, **part})
    return folder
