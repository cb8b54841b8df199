"""How the objects that the verbs return show themselves, and what they are turned into."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from egolane_pgm.views.clips import clip_parts, drive_parts
from egolane_pgm.views.events import event_lines, event_rows, lane_words, sure_words
from egolane_pgm.views.tables import (
    TUNED_ON,
    TUNED_ON_SHORT,
    Table,
    causal_text,
    confusion_table,
    page,
    score_rows,
    with_interval,
)

if TYPE_CHECKING:
    from egolane_pgm.results import Result


def how_tuned(found: Mapping[str, Any]) -> str:
    """On which frames the parameters were tuned, and whether a belief uses earlier frames only."""
    return f"{TUNED_ON_SHORT[found['tuned_on']]}, {causal_text(found)}"


def html_table(
    title: str, header: Sequence[str], rows: Sequence[Sequence[str]], notes: Sequence[str] = ()
) -> str:
    """A title, a table and some notes for a notebook."""

    def line(cells: Sequence[str], tag: str) -> str:
        return "".join(f"<{tag}>{html.escape(str(cell))}</{tag}>" for cell in cells)

    body = "".join(f"<tr><th>{html.escape(str(r[0]))}</th>{line(r[1:], 'td')}</tr>" for r in rows)
    return (
        f"<div><p>{html.escape(title)}</p>"
        f"<table><thead><tr>{line(header, 'th')}</tr></thead><tbody>{body}</tbody></table>"
        + "".join(f"<p>{html.escape(note)}</p>" for note in notes)
        + "</div>"
    )


def scored(result: Result) -> dict[str, Any]:
    """The scores of the model, and of the detector alone where they are known."""
    scores = result.scores
    return {who: scores[who] for who in ("model", "detector") if who in scores}


def result_title(result: Result) -> str:
    """A run in one line: what run.json says, and the scores of the model and of the detector."""
    run = result.run
    parts = [f"{run['name']!r}: {run['frames']} frames"]
    for who, scores in scored(result).items():
        said = with_interval(scores["accuracy"], scores["intervals"]["accuracy"])
        parts.append(f"{'accuracy' if who == 'model' else who} {said}")
    if len(parts) == 1:
        parts.append("no ground truth")
    return f"{', '.join(parts)}; {how_tuned(run)}"


def result_html(result: Result) -> str:
    """The same with a table of the scores, for a notebook."""
    header, rows = score_rows(scored(result))
    return html_table(result_title(result), header, rows if scored(result) else [], result.notes)


def result_text(result: Result, style: str, wide: bool) -> str:
    """What `egolane run` prints: scores and confusions, or the lane over time, then the lane
    changes."""
    said, more = result.scores, _more_parts(result)
    mean = said["mean_log_evidence"]
    first = [
        f"{said['name']}: {len(result)} frames, {result.n_lanes} lanes,"
        f" graph {result.experiment.graph},"
        f" mean log evidence {math.nan if mean is None else mean:.4f}",
        *said["why_not_causal"],
    ]
    if result.block is not None:
        how = f"{result.run['blocks']} blocks: each is believed with {_FOUND[result.run['fit']]}"
        first.append(f"held out, {how}")
    scores = scored(result)
    if not scores:
        first.append("no ground truth: beliefs only, no scores (ground_truth names a file)")
        parts = ["\n".join(first), *more, *_lane_parts(result), *_event_parts(result)]
        return page(parts, style, wide)
    first.append(f"{said['frames_scored']} frames scored (crossing ones are not);")
    first.append(f"parameters: {TUNED_ON[said['tuned_on']]}")
    matrices = [confusion_table(scores[who]["confusion"], who) for who in reversed(scores)]
    parts = ["\n".join(first), Table(*score_rows(scores)), *more, *matrices]
    return page([*parts, *_event_parts(result)], style, wide)


#: What a block is believed with, by the experiment's `fit`.
_FOUND = {
    "none": "the experiment's own parameters",
    "learn": "what was learned without it, neither its labels nor its lines looked at",
    "tune": "what was searched without it",
}


def _more_parts(result: Result) -> list[str | Table]:
    """What is said of roads whose lanes change, and of results that held something out, in addition
    to those of others."""
    parts: list[str | Table] = []
    if result.road_lanes is not None and result.truth is not None:
        parts += drive_parts(result)
    everywhere = result.scores.get("model_all_frames")
    if everywhere:
        count = everywhere["frames_scored"]
        parts.append(f"the same over all {count} frames, those of tuning.never_fit too")
        parts.append(Table(*score_rows({"model": everywhere})))
    if result.scores.get("log_evidence"):
        parts.append(evidence_words(result.scores["log_evidence"]))
    return parts


def evidence_words(found: Mapping[str, float]) -> str:
    """The log evidence of a frame, `before` learning and `held_out` after it."""
    return (
        f"log evidence per frame, exact filter: {found['before']:.4f} with the starting tables,"
        f" {found['held_out']:.4f} with the learned ones, held out"
    )


def _lane_parts(result: Result) -> list[str | Table]:
    sure = sure_words(result.scores)
    if result.clip is not None:
        where = "a row for each clip: clips.csv; its frames: beliefs.parquet"
        return [*clip_parts(result), f"{sure}\n{where}"]
    last = result.beliefs.lane[-1]
    best = int(last.argmax())
    at_the_end = f"at the end lane {best + 1} is the most probable ({last[best]:.2f})"
    return [f"{lane_words(result.scores)}; {at_the_end}\n{sure}"]


def _event_parts(result: Result) -> list[str | Table]:
    if result.clip is not None and result.road_lanes is None:
        return []
    events, scores = result.events, result.scores["events"]
    header, rows = event_rows(events)
    parts: list[str | Table] = [Table(header, rows) if rows else "no lane change was believed"]
    if len(events) > len(rows):
        parts.append(f"and {len(events) - len(rows)} more in events.csv")
    if "within" in scores:
        parts.append("\n".join(event_lines(scores)))
    return parts
