"""What a search knows of the recordings that it searches on."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from egolane_pgm.parameters import Value
from egolane_pgm.tools.files import plain
from egolane_pgm.tuning.plan import Plan
from egolane_pgm.tuning.search import Score, Settings
from egolane_pgm.tuning.space import Point, SearchSpace, describe


@dataclass(frozen=True)
class Task:
    """All that a search knows of what it searches on.

    - spaces: the search space of each thing that is searched on, by name. Their dimensions are the
      same; the values of the parameters that are not searched may differ.
    - starts: points that the study on everything tries first.
    - notes: what a user should know, a line each.
    - held_out: "blocks", "recordings" (the parts of a fleet), or "none" for in-sample scores only.
    - part: what is held out in turn, in a word.
    - left_out: the name of each part that is held out in turn, None for a block.
    - identity: what makes two studies the same one, as JSON, so that none goes on with trials of
      another. The number of trials may grow.
    - parts_key: on what more than that the studies without a part depend.
    - data: a `drive.file_entry` for each file.
    - document: keys of study.json that say what is searched on.
    - scorer: makes the score of a point: on everything, or (a number) without that part.
    - answers: what one point gives for everything, or each of several points for its part.
    - assess: the scores of answers with their intervals, by the frames that count; with other
      answers, less the scores of these.
    - parameters: what a point means, by name.
    - experiments: the parameters of a point as YAML files that `egolane run` takes or includes, by
      the name of the file.
    """

    plan: Plan
    settings: Settings
    spaces: Mapping[str, SearchSpace]
    starts: Sequence[Point]
    notes: Sequence[str]
    held_out: str
    part: str
    left_out: Sequence[str | None]
    identity: Mapping[str, Any]
    parts_key: Mapping[str, Any]
    data: Sequence[Mapping[str, Any]]
    document: Mapping[str, Any]
    scorer: Callable[[int | None], Score]
    answers: Callable[[Sequence[Point]], Any]
    assess: Callable[..., dict[str, Any]]
    parameters: Callable[[Point], dict[str, dict[str, Value]]]
    experiments: Callable[[Point], dict[str, dict[str, Any]]]

    @property
    def space(self) -> SearchSpace:
        """The dimensions that are searched."""
        return next(iter(self.spaces.values()))

    @property
    def key(self) -> dict[str, Any]:
        """What the results of the studies without a part depend on."""
        return {**self.identity, "trials": self.settings.trials, **self.parts_key}


def task_of(plan: Plan, held_out: str = "blocks") -> Task:
    """Read what a plan searches on. held_out: see `Task`.

    Raises InputError for whatever does not fit, before anything is computed.
    """
    from egolane_pgm.tuning.recording_task import recording_task

    return recording_task(plan, held_out)


def identity_of(plan: Plan, spaces: Mapping[str, SearchSpace], **more: Any) -> dict[str, Any]:
    """A task's `identity`. more: keys on what is searched on, with checksums of data."""
    settings = plan.settings
    identity = {
        "name": plan.name,
        "objective": list(settings.objectives),
        "sampler": settings.sampler,
        "seed": settings.seed,
        "from_scratch": plan.tuning.from_scratch,
        "space": {
            "searched": describe(next(iter(spaces.values())))["searched"],
            "fixed": {name: describe(space)["fixed"] for name, space in spaces.items()},
        },
        **more,
    }
    return dict(json.loads(json.dumps(plain(identity))))
