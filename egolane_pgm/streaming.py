"""One experiment on a recording of any length: read, filtered, scored and written part after part.

The numbers are those of `running.run_experiment`; the memory does not grow with the drive, but for
a row for each lane change, told or true. What needs all frames at once is refused
(`check_streamed`) or left out, and the result says so (`LEFT_OUT`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment, resolved
from egolane_pgm.inference.events import (
    NOTHING_TOLD,
    SURE,
    Telling,
    crossing_probability,
    stretches,
    tell,
)
from egolane_pgm.inference.filtering import piece_frames, step
from egolane_pgm.inference.layout import FilterState
from egolane_pgm.loading import Recorded, stream_recording
from egolane_pgm.model import Model, causality, model_to_run, online_output
from egolane_pgm.results import BELIEFS, LINES, staged, write_summary
from egolane_pgm.running import (
    note_of_impossible,
    portable,
    provenance_of,
    result_rows,
    said_of,
)
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.events import FrameCounts, event_delays, event_scores, landmarks
from egolane_pgm.scoring.summary import ScoreSums, no_frames, running_sum, scores_of, with_frames
from egolane_pgm.tools.files import arrow_table, parquet_writer, plain
from egolane_pgm.types import (
    NOTE,
    Beliefs,
    FloatArray,
    InputError,
    IntArray,
    LaneEvents,
    LaneTruth,
    all_problems,
)

#: So many frames are held at once, about.
PART_FRAMES = 2**14

#: What a result without some scores says of itself.
LEFT_OUT = (
    f"{NOTE}run as a stream: intervals, the AUC of warnings and what is noted of all lines together"
    " (lane width, number of lanes) need all frames at once and are left out"
)


@dataclass(frozen=True)
class StreamedRun:
    """An experiment that was run as a stream; its beliefs are in its result directory only.

    run, scores: the content of run.json and scores.json.
    events: the lane changes that were told.
    last (n,): the belief over lanes in the last frame.
    """

    directory: Path
    experiment: Experiment
    run: Mapping[str, Any]
    scores: Mapping[str, Any]
    events: LaneEvents
    last: FloatArray


def check_streamed(experiment: Experiment, model: Model) -> None:
    """Raise InputError, a line for each key, where a belief needs more than the frames up to its
    own."""
    source, reasons = experiment.source, causality(experiment, model)["why_not_causal"]
    with all_problems() as part:
        if not experiment.has_causal_filter:
            with part():
                raise InputError(
                    f"{source}: filter: {experiment.filter} uses later frames and is not streamed;"
                    " exact and assumed_density are"
                )
        if experiment.decode != "marginal":
            with part():
                raise InputError(
                    f"{source}: decode: {experiment.decode} needs the whole drive and is not"
                    " streamed; marginal is"
                )
        for reason in reasons[not experiment.has_causal_filter :]:
            with part():
                raise InputError(f"{source}: evidence: {reason}; that is not streamed")


def run_streamed(
    experiment: Experiment, directory: str | Path, advance: Callable[[int], Any] = int
) -> StreamedRun:
    """Run an experiment part after part and write its result directory. An older one is replaced;
    files of others in it stay.

    - advance: is told of each part how many frames it has.

    Raises InputError, one line, for whatever does not fit, for what needs the whole drive, and
    where the directory cannot be written: then it is as it was.
    """
    # pyarrow is imported only where there is something to write.
    from egolane_pgm.recordings.table import rows_of

    begun = time.perf_counter()
    directory = Path(directory)
    _check_road(experiment)
    model = model_to_run(experiment)
    check_streamed(experiment, model)
    piece = piece_frames(model.compiled)
    size = max(1, PART_FRAMES // piece) * piece
    recording = stream_recording(experiment, model.parameters, size, piece // 2)
    output_of = online_output(model, experiment.evidence_reading)
    n_lanes, below = experiment.n_lanes, experiment.unassigned_below
    totals = _Totals({}, last=np.zeros(n_lanes))
    state: FilterState | None = None
    source = ""
    with staged(directory) as folder:
        with (
            parquet_writer(folder / BELIEFS) as write_beliefs,
            parquet_writer(folder / LINES) as write_lines,
        ):
            for part in recording.parts:
                output = output_of(part.log)
                state, beliefs = step(model.compiled, state, output.filtered, experiment.filter)
                beliefs = replace(beliefs, frame_id=part.log.frame_id)
                assigned = assigned_lane(beliefs.lane, below)
                totals = _added(totals, part, output.tentative, beliefs, assigned)
                rows = result_rows(experiment, model, part, beliefs, output.tentative, assigned)
                write_beliefs(arrow_table(rows.columns()))
                write_lines(rows_of(part.log, says_missing=True))
                source = part.log.source
                advance(len(part.log))
        notes = [*recording.notes, *note_of_impossible(source, totals.impossible), LEFT_OUT]
        content = resolved(experiment, model.parameters)
        counts, scores, events = _scores(totals, experiment)
        run = plain(
            {
                **provenance_of(experiment, model, recording.files, content, counts, notes),
                "seconds": round(time.perf_counter() - begun, 3),
            }
        )
        said = said_of(experiment, model, counts, notes)
        scores = plain({"name": experiment.name, **said, **scores})
        write_summary(
            folder, portable(experiment, model, plain(content), folder), events, run, scores
        )
    return StreamedRun(directory, experiment, run, scores, events, totals.last)


def _check_road(experiment: Experiment) -> None:
    """Raise InputError for a road whose lanes change, or positions on it."""
    if experiment.gnss is None and not experiment.follows_map:
        return
    key = "gnss" if experiment.gnss is not None else "n_lanes"
    raise InputError(
        f"{experiment.source}: {key}: a road table is laid over the whole drive and is not"
        " streamed; leave it out, and give n_lanes as a number"
    )


@dataclass(frozen=True)
class _Totals:
    """What is kept of the parts so far.

    scores: the sums of `model` and, with a tentative vector, `detector`; none without truth.
    frames, impossible, sure: how many frames there are, and are so.
    log_evidence: its sum over the possible frames.
    telling, events: of lane changes.
    counts: of annotated frames.
    landmarks: the annotated frames among them at which anything begins or ends, and the probability
        of being on a line in these.
    last (n,), last_s: the belief over lanes in the last frame, and its time, seconds.
    """

    scores: Mapping[str, ScoreSums]
    frames: int = 0
    impossible: int = 0
    sure: int = 0
    log_evidence: float = 0.0
    telling: Telling = NOTHING_TOLD
    events: tuple[LaneEvents, ...] = ()
    counts: FrameCounts = field(default_factory=FrameCounts)
    landmarks: tuple[tuple[LaneTruth, FloatArray | None], ...] = ()
    last: FloatArray = field(default_factory=lambda: np.zeros(0))
    last_s: float = 0.0


def _added(
    totals: _Totals,
    part: Recorded,
    tentative: FloatArray | None,
    beliefs: Beliefs,
    assigned: IntArray,
) -> _Totals:
    """The totals with one more part of T frames."""
    log, truth = part.log, part.truth
    is_possible = ~beliefs.is_impossible
    telling, _, events = tell(totals.telling, beliefs, log.time_s)
    totals = replace(
        totals,
        frames=totals.frames + len(log),
        impossible=totals.impossible + int(beliefs.is_impossible.sum()),
        sure=totals.sure + int((beliefs.lane.max(axis=1) >= SURE).sum()),
        log_evidence=running_sum(totals.log_evidence, beliefs.log_evidence[is_possible]),
        telling=telling,
        events=(*totals.events, *([events] if len(events) or not totals.events else [])),
        last=beliefs.lane[-1],
        last_s=float(log.time_s[-1]),
    )
    if truth is None:
        return totals
    # A tentative vector is no belief: the reject option is the model's.
    named = {"model": (beliefs.lane, assigned)}
    if tentative is not None:
        named = {"detector": (tentative, assigned_lane(tentative)), **named}
    scores = {}
    for name, (belief, answers) in named.items():
        sums = totals.scores.get(name) or no_frames(belief.shape[1])
        frames = (belief[part.scored], truth.lane, truth.is_crossing, truth.frame_id)
        scores[name] = with_frames(sums, *frames, answers[part.scored])
    crossing = crossing_probability(beliefs.take(part.scored).marginals)
    kept = landmarks(events, crossing, truth)
    place = (truth.take(kept), None if crossing is None else crossing[kept])
    return replace(
        totals,
        scores=scores,
        counts=totals.counts.plus(crossing, truth),
        landmarks=(*totals.landmarks, place),
    )


def _scores(
    totals: _Totals, experiment: Experiment
) -> tuple[dict[str, Any], dict[str, Any], LaneEvents]:
    """The counts of frames, the scores of scores.json, and the lane changes."""
    rate = experiment.recording.frame_rate
    events = LaneEvents.joined(totals.events)
    of_events: dict[str, Any] = {"told": len(events)}
    scores: dict[str, Any] = {}
    if totals.landmarks:
        truth = LaneTruth.joined([truth for truth, _ in totals.landmarks])
        found = [crossing for _, crossing in totals.landmarks if crossing is not None]
        crossing = np.concatenate(found) if found else None
        of_events = event_scores(events, crossing, truth, rate, totals.counts)
        intervals = {"intervals": {"accuracy": None, "f1": None}}
        scores = {
            name: {**scores_of(sums, rate), **intervals} for name, sums in totals.scores.items()
        }
        events = replace(events, delay_s=event_delays(events, truth, rate))
    n_possible = totals.frames - totals.impossible
    counts = {
        "frames": totals.frames,
        "frames_scored": totals.counts.frames - totals.counts.crossing,
        "mean_log_evidence": totals.log_evidence / n_possible if n_possible else None,
        "impossible_frames": totals.impossible,
    }
    rest = {
        "sure": totals.sure / totals.frames,
        "lanes": stretches(totals.telling.first, events, totals.last_s),
        "events": of_events,
    }
    return counts, {**scores, **rest}, events
