"""Lane changes side by side: how right each experiment is about them."""

from __future__ import annotations

from typing import Any

from egolane_pgm.comparing.side import Side
from egolane_pgm.inference.events import crossing_probability, lane_events
from egolane_pgm.scoring.events import event_scores
from egolane_pgm.types import BoolArray


def side_events(side: Side, keep: BoolArray) -> dict[str, Any]:
    """The scores of an experiment's lane changes, as `scoring.events.event_scores`, over the frames
    (K,) that are kept. The changes are found in all annotated frames."""
    experiment, truth = side.experiment, side.truth.take(keep)
    rate = experiment.recording.frame_rate
    events = lane_events(side.beliefs, rate, lag=experiment.lag)
    crossing = crossing_probability(side.beliefs.take(keep).marginals)
    return event_scores(events, crossing, truth, rate)
