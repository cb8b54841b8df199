"""Lane changes in tables and lines of text: one by one, and how right they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from egolane_pgm.inference.events import BELIEVED, SURE
from egolane_pgm.types import DATED_S, UNASSIGNED, LaneEvents
from egolane_pgm.views.comparison_tables import entries_of, trusted_or_all
from egolane_pgm.views.tables import score_text

#: How many lane changes a table lists.
LISTED = 10

#: The times of a shorter drive have a decimal, seconds.
SHORT_S = 60.0

LEGEND = """\
Lane changes, told in the frame in which the new lane is first believed. Right: told at most 2 s
(0.5 s) before the true crossing begins or after it ends, from and to the true lanes, or to the true
side where no lane is believed. Delay: from
the end of the true crossing to the telling, seconds, negative where it was told before. Crossing:
the probability that the car is on a line between two lanes; its AUC for "this frame is crossing",
how many changes have a warning (from .5 on) while they last, how many seconds before the label's
change it begins, and how many warnings an hour have no crossing within 2 s. Frames of untrusted
labels (tuning.never_fit) are left out. More: in the JSON."""


def event_rows(events: LaneEvents) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the first lane changes, one each."""
    header = ["time, s", "frame", "from", "to", "probability", "told, s", "late, s"]
    if events.delay_s is not None:
        header.append("delay, s")
    rows = []
    for e in range(min(LISTED, len(events))):
        row = [
            f"{events.time_s[e]:.1f}",
            str(events.frame_id[e]),
            *_lanes_of(events, e),
            f"{events.told_time_s[e]:.1f}",
            f"{events.late_s[e]:.1f}",
        ]
        if events.delay_s is not None:
            delay = events.delay_s[e]
            row.append("no change" if delay != delay else f"{delay:+.1f}")
        rows.append(row)
    return header, rows


def _lanes_of(events: LaneEvents, e: int) -> tuple[str, str, str]:
    """The lanes of a change and its probability; the direction where the lanes are not known."""
    if events.from_lane[e] == UNASSIGNED:
        return "?", "left" if events.direction[e] < 0 else "right", "-"
    return str(events.from_lane[e]), str(events.to_lane[e]), f"{events.probability[e]:.3f}"


def lane_words(summary: Mapping[str, Any]) -> str:
    """The lane over time in words.

    - summary: `lanes`, as in scores.json.
    """
    stretches = summary["lanes"]
    if not stretches:
        return f"no lane is believed (at least {BELIEVED:.2f}) in any frame"
    digits = 1 if stretches[-1][2] - stretches[0][1] < SHORT_S else 0
    said = [
        f"lane {lane or 'unknown'} from {clock(start, digits)} to {clock(end, digits)}"
        for lane, start, end in stretches[:LISTED]
    ]
    if len(stretches) > LISTED:
        said.append(f"and {len(stretches) - LISTED} more in events.csv")
    return ", ".join(said)


def sure_words(summary: Mapping[str, Any]) -> str:
    """In how many frames the lane is sure, and what that means.

    - summary: `sure`, as in scores.json.
    """
    return f"sure (a belief of at least {SURE:g}) in {100 * summary['sure']:.1f} % of the frames"


def clock(seconds: float, digits: int = 0) -> str:
    """A time as 1:02 or 1:00:02, with this number of decimals; for one since 1970 the time of day,
    UTC."""
    seconds = round(seconds, digits)
    minutes, rest = divmod(seconds % 86400 if seconds >= DATED_S else seconds, 60)
    width = 3 + digits if digits else 2
    hours, minutes = divmod(int(minutes), 60)
    text = f"{minutes:02d}" if hours else str(minutes)
    return f"{hours}:" * bool(hours) + f"{text}:{rest:0{width}.{digits}f}"


def event_lines(scores: Mapping[str, Any]) -> list[str]:
    """What the scores of `scoring.events.event_scores` say, in a few lines of text."""
    lines = [f"{scores['changes']} true lane changes, {scores['told']} told:"]
    for seconds, found in scores["within"].items():
        lines.append(
            f"  within {seconds} s: precision {score_text(found['precision'])},"
            f" recall {score_text(found['recall'])},"
            f" {score_text(found['false_per_hour'], 1)} false an hour"
        )
    delay = scores["delay_s"]
    lines.append(
        f"  delay from the end of the crossing: {_signed(delay['median'])} s (median),"
        f" {_signed(delay['p90'])} s (90 %)"
    )
    warning = scores["crossing"]
    if warning is not None:
        lines.append(
            f"on a line (crossing): AUC {score_text(warning['auc'])}, precision"
            f" {score_text(warning['precision'])}, recall {score_text(warning['recall'])} of the"
            f" crossing frames; {warning['warned']} of {warning['changes']} changes warned of,"
            f" {score_text(warning['lead_s']['median'], 1)} s (median) before the label changes,"
            f" {score_text(warning['false_per_hour'], 1)} false warnings an hour"
        )
    return lines


def _signed(seconds: float | None) -> str:
    # Adding 0 takes the sign from a rounded -0.0.
    return "-" if seconds is None else f"{round(seconds, 1) + 0.0:+.1f}"


#: The columns of the scores of several runs.
_SCORED = ["changes", "told", "right", "precision", "recall", "false/h"]
_SCORED += ["precision .5 s", "recall .5 s", "delay median", "delay 90 %"]
_SCORED += ["crossing AUC", "warned", "lead median", "false warnings/h"]


def _scored(scores: Mapping[str, Any]) -> list[str]:
    if "within" not in scores:
        return ["", str(scores["told"]), *[""] * (len(_SCORED) - 2)]
    wide, narrow = scores["within"]["2"], scores["within"]["0.5"]
    warning = scores["crossing"]
    row = [f"{count:g}" for count in (scores["changes"], scores["told"], wide["right"])]
    row += [score_text(wide["precision"]), score_text(wide["recall"])]
    row.append(score_text(wide["false_per_hour"], 1))
    row += [score_text(narrow["precision"]), score_text(narrow["recall"])]
    row += [_signed(scores["delay_s"][key]) for key in ("median", "p90")]
    if warning is None:
        return [*row, *["-"] * 4]
    row += [score_text(warning["auc"]), f"{warning['warned']:g}"]
    row.append(score_text(warning["lead_s"]["median"], 1))
    return [*row, score_text(warning["false_per_hour"], 1)]


def _pooled(scores: Sequence[Mapping[str, Any]]) -> list[str]:
    """The row of several runs whose changes are counted together."""
    hours = sum(found["hours"] for found in scores)

    def total(tolerance: str, key: str) -> float:
        return float(sum(found["within"][tolerance][key] for found in scores))

    def share(tolerance: str, other: str) -> str:
        right = total(tolerance, "right")
        among = right + total(tolerance, other)
        return score_text(right / among if among else None)

    counts = [sum(found[key] for found in scores) for key in ("changes", "told")]
    row = [f"{count:g}" for count in (*counts, total("2", "right"))]
    row += [share("2", "false"), share("2", "missed")]
    row.append(score_text(total("2", "false") / hours if hours else None, 1))
    row += [share("0.5", "false"), share("0.5", "missed")]
    return [*row, *[""] * (len(_SCORED) - len(row))]


def event_runs_rows(summaries: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the lane changes of several runs, each as `running.summary` gives it."""
    rows = [[found["name"], *_scored(found["events"])] for found in summaries]
    return ["run", *_SCORED], rows


def event_comparison_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """The same of a comparison's document, over the frames whose labels can be trusted: a row per
    recording and experiment, and one per experiment for all recordings that it is on."""
    rows = []
    found: dict[str, list[Mapping[str, Any]]] = {}
    for title, entry in entries_of(document):
        scores = trusted_or_all(entry["events"])
        rows.append([title, entry["name"], *_scored(scores)])
        found.setdefault(entry["name"], []).append(scores)
    for name, of_all in found.items():
        if len(of_all) > 1:
            rows.append([f"all {len(of_all)}", name, *_pooled(of_all)])
    return ["lane changes", "experiment", *_SCORED], rows
