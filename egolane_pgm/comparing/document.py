"""What `egolane compare --json` writes: each key with its type and its meaning."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from egolane_pgm.experiment import validated
from egolane_pgm.results import Causal, read_json, refusing_damage
from egolane_pgm.scoring.document import Count, Finite, Scores, Share, Stored

#: The file of a comparison's directory that has the numbers.
DOCUMENT = "comparison.json"

#: Per score [estimate, low, high].
Differences = dict[str, Annotated[list[Finite], Field(min_length=3, max_length=3)] | None]


def folder_of(title: str) -> str:
    """A recording's title as the name of a directory."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", title).strip("._-") or "recording"


class Compared(Stored):
    """What a comparison says of an experiment on a recording."""

    name: str = Field(description="name of the experiment")
    scores: dict[str, Scores] = Field(
        description="by which frames: `all_frames`, and others that the comparison names"
    )
    source: str = Field(description="name of its file")
    graph: str = Field(description="graph")
    evidence: str = Field(description="evidence rule")
    filter: str = Field(description="filter")
    fit: str = Field(description="how parameters were fitted without each block")
    tuned_on: str = Field(description="what the parameters have seen, as in the experiment")
    is_causal: bool = Field(description="false: a belief about a frame uses later frames too")
    causal: Causal = Field(description="the same of filter and evidence apart")
    why_not_causal: list[str] = Field(description="a line for each that is not")
    unassigned_below: Share = Field(description="probability that an answer needs")
    free_parameters: Count | None = Field(
        description="numbers that were fitted to labels; null in a plain run"
    )
    fixed_parameters: Count | None = Field(description="numbers that `fit: tune` does not search")
    trials: Count | None = Field(description="trials of each block's search")
    microseconds_per_frame: Finite | None = Field(description="evidence and filter")
    parameters: list[dict[str, Any]] = Field(
        description="per block those that were fitted without it"
    )
    difference_to: str | None = Field(description="name of the first experiment")
    difference: dict[str, Differences] | None = Field(
        description="per choice of frames and score, 95 % by paired block bootstrap"
    )
    events: dict[str, Any] | None = Field(description="scores of lane changes, if asked for")


class ComparedRecording(Stored):
    """What a comparison says of a recording."""

    title: str = Field(description="what it is called")
    drive: str | None = Field(
        default=None, description="title of the first recording of its drive, if known"
    )
    run: Count | None = Field(description="the paper's run, if it is one")
    frames: Count = Field(description="annotated frames")
    blocks: Count | None = Field(description="parts that were held out, one after the other")
    notes: list[str] = Field(description="what was odd, a line each")
    experiments: list[Compared] = Field(min_length=1, description="the first is compared with")


class Together(Stored):
    """An experiment over several recordings: plain means."""

    name: str = Field(description="name of the experiment")
    recordings: Count = Field(description="how many there are")
    drives: Count = Field(description="number of different drives")
    scores: Differences = Field(description="per score, null where a drive is short")
    difference: Differences | None = Field(description="to the first experiment")


class Comparison(Stored):
    """`egolane compare --json`; see `comparing.compared.document`."""

    schema_version: int = Field(description="version of these keys")
    held_out: bool = Field(description="whether every result was made block by block")
    blocks: Count | None = Field(description="parts that were held out, one after the other")
    recordings: list[ComparedRecording] = Field(
        min_length=1, description="those that were compared"
    )
    together: list[Together] = Field(description="the experiments over all recordings")
    failed: list[dict[str, Any]] = Field(description="title, run and error of the others")


def read_document(file: Path) -> Any:
    """What comparison.json says. Raises InputError in one line,
    naming the file and a key that does not fit."""
    with refusing_damage(file, "; compare again"):
        content = read_json(file)
        validated(Comparison, content, str(file))
    return content
