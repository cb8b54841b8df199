"""The scores as a program writes them into JSON: each key with its type and its meaning."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import ConfigDict, Field, model_validator

from egolane_pgm.experiment import Section

Count = Annotated[int, Field(ge=0, le=2**53)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]

Bounds = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class Stored(Section):
    """A part of a file that a program wrote: types are as JSON has them, further keys are kept."""

    model_config = ConfigDict(extra="allow", strict=True, defer_build=True)


class Delay(Stored):
    """How late lane changes are held, in frames; see `scoring.stability`."""

    median_frames: Finite | None = Field(description="median over the changes that were not missed")
    p90_frames: Finite | None = Field(description="90th percentile of the same")
    share_missed: Share | None = Field(description="share of the changes that were never held")
    changes: Count = Field(description="true lane changes")


class PerLane(Stored):
    """Scores of each lane, from lane 1."""

    precision: list[Share] = Field(description="right over predicted as that lane")
    recall: list[Share] = Field(description="right over actual")
    f1: list[Share] = Field(description="harmonic mean of the two")


class Intervals(Stored):
    """95 % intervals [low, high]; null for a short drive."""

    accuracy: Bounds | None = Field(description="[low, high]")
    f1: Bounds | None = Field(description="[low, high]")


class Scores(Stored):
    """All scores of one belief, see `scoring.summary.score_with_intervals`; null where a score is
    not defined. Row k of `confusion` counts the frames that were answered k + 1, the last row those
    without an answer; column k those whose true lane is k + 1."""

    precision: Share = Field(description="mean over the lanes")
    recall: Share = Field(description="mean over the lanes")
    f1: Share = Field(description="mean over the lanes of their F1 (macro F1)")
    accuracy: Share = Field(description="right over scored frames")
    log_loss: Finite | None = Field(description="over all annotated frames, crossing ones too")
    brier: Finite | None = Field(description="0 to 2, 0 is perfect")
    expected_calibration_error: Finite | None = Field(description="0 to 1, 15 bins")
    coverage: Share = Field(description="share of scored frames that get an answer")
    false_switches_per_minute: Finite | None = Field(
        description="of the assigned lane, while the true one stays"
    )
    delay: Delay = Field(description="how late lane changes are held")
    per_lane: PerLane = Field(description="scores of each lane")
    confusion: list[list[Count]] = Field(description="n + 1 rows of n counts")
    frames: Count = Field(description="annotated frames")
    frames_scored: Count = Field(description="those that are not crossing")
    intervals: Intervals = Field(description="95 % block-bootstrap intervals")

    @model_validator(mode="after")
    def _is_of_one_road(self) -> Self:
        n_lanes = len(self.confusion) - 1
        if n_lanes < 1 or any(len(row) != n_lanes for row in self.confusion):
            raise ValueError("confusion is not of n + 1 rows of n counts")
        return self


class Reported(Stored):
    """How right the reported lane changes are, within some seconds."""

    right: Count = Field(description="events that match a true change")
    false: Count = Field(description="events that match none, in annotated frames")
    missed: Count = Field(description="true changes that are not reported")
    precision: Share | None = Field(description="right / (right + false)")
    recall: Share | None = Field(description="right / (right + missed)")
    false_per_hour: Finite | None = Field(description="false events per hour of annotated frames")


class EventDelay(Stored):
    """Seconds from the end of a true crossing to the report."""

    median: Finite | None = Field(description="seconds, negative for a report before the end")
    p90: Finite | None = Field(description="90th percentile, seconds")


class Lead(Stored):
    """Seconds from a warning to the lane change."""

    median: Finite | None = Field(description="seconds")
    p10: Finite | None = Field(description="10th percentile, seconds")


class Warned(Stored):
    """How early the car is seen to cross a line, see `scoring.events.score_crossing`."""

    auc: Share | None = Field(description="area under the ROC curve for `this frame is crossing`")
    precision: Share | None = Field(description="share of warned frames that are crossing")
    recall: Share | None = Field(description="share of crossing frames that are warned of")
    changes: Count = Field(description="true lane changes")
    warned: Count = Field(description="those that a warning precedes or meets")
    lead_s: Lead = Field(description="from the warning to the change of the label")
    warnings: Count = Field(description="how many there are")
    false_per_hour: Finite | None = Field(description="warnings far from any crossing, per hour")


class Events(Stored):
    """The reported lane changes: their number, and, with ground truth, how right they are; see
    `scoring.events.event_scores`."""

    told: Count = Field(
        description="reported lane changes; with ground truth those that can be right or false"
    )
    changes: Count | None = Field(default=None, description="true lane changes")
    hours: Finite | None = Field(default=None, description="of annotated frames")
    within: dict[str, Reported] | None = Field(
        default=None, description="per tolerance in seconds, `0.5`, `1` and `2`"
    )
    delay_s: EventDelay | None = Field(
        default=None, description="from the end of the true crossing to the report"
    )
    crossing: Warned | None = Field(
        default=None,
        description="the probability of being on a line as a warning, of graphs with RoadPosition",
    )
