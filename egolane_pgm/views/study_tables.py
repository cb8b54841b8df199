"""The paper's two parameter tables anew: ours next to theirs, in-sample and held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from egolane_pgm.fleet import TAG
from egolane_pgm.paper import SCORES, load_published
from egolane_pgm.scoring.confusion import scores_from_confusion
from egolane_pgm.views.study_trials import Trials, importances
from egolane_pgm.views.tables import score_text, with_interval

#: The scores in the tables.
SHOWN = ("accuracy", "f1", "log_loss")

COUNTRIES = {"italy": "A4, Italy", "spain": "A2, Spain"}


def legend(documents: Sequence[Mapping[str, Any]]) -> str:
    """What the columns mean; printed with every table."""
    part, drawn = "each block of the drive", "of a block bootstrap"
    if any(document.get("fleet") for document in documents):
        part, drawn = "each part of the drives", "over drives, which are drawn whole"
    return (
        f"in-sample: on the frames that the parameters were tuned on; held out: {part} with"
        f" parameters found without it, the search run anew; in brackets 95 % intervals {drawn}"
    )


def drive_rows(document: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row for each drive of a fleet, as those of `fleet.summary_rows`, scored held out; none for
    other studies, and where nothing was held out."""
    if not document.get("fleet") or document["held_out"] is None:
        return []
    part_of = {
        name: number for number, part in enumerate(document["fleet"]["parts"], 1) for name in part
    }
    return [
        {
            "name": drive["name"],
            **{f"{TAG}{k}": v for k, v in document["fleet"]["tags"][drive["name"]].items()},
            "drive": document["fleet"]["drives"][drive["name"]],
            "error": None,
            "part": part_of[drive["name"]],
            "frames_scored": drive["frames_scored"],
            "model.accuracy": drive["accuracy"],
        }
        for drive in document["held_out"]["all_frames"]["recordings"]
    ]


def parameter_rows(
    documents: Sequence[Mapping[str, Any]], score: str = "accuracy"
) -> tuple[list[str], list[list[str]]]:
    """Header and rows: per study one row of ours and, for a run of the paper, one of theirs above.

    documents: contents of study.json. score: in-sample, held out and their difference.
    """
    names = list(dict.fromkeys(k for d in documents for k in _searched(d)))
    header = ["study", "whose", *names, f"{score}, in-sample", f"{score}, held out", "difference"]
    rows = []
    for document in documents:
        if document["run"] is not None and score in SCORES:
            rows.append(_theirs(document, names, score))
        point = document["best"]["point"]
        rows.append(
            [
                document["name"],
                "ours",
                *(_value(point.get(name)) for name in names),
                score_text(document["in_sample"]["all_frames"][score]),
                _cell(document["held_out"], score),
                _cell(document["difference"], score, sign="+"),
            ]
        )
    return header, rows


def by_country(documents: Sequence[Mapping[str, Any]]) -> dict[str, list[Mapping[str, Any]]]:
    """The studies per table of the paper; what is no single run comes last."""
    found: dict[str, list[Mapping[str, Any]]] = {}
    for key, title in COUNTRIES.items():
        mine = [d for d in documents if d["run"] is not None and key in d["name"]]
        if mine:
            found[title] = mine
    others = [d for d in documents if not any(d in mine for mine in found.values())]
    if others:
        found["Studies"] = others
    return found


def score_rows(document: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Header and rows: per score in-sample, held out, their difference; and without the frames
    that are never fitted, where there are any."""
    header = ["score", "in-sample", "held out", "difference"]
    rows = []
    for subset, suffix in (("all_frames", ""), ("without_never_fit", ", without never_fit")):
        if subset not in document["in_sample"]:
            continue
        for score in SHOWN:
            row = [
                f"{score}{suffix}",
                _cell(document["in_sample"], score, subset),
                _cell(document["held_out"], score, subset),
                _cell(document["difference"], score, subset, "+"),
            ]
            rows.append(row)
    return header, rows


def importance_line(trials: Trials) -> str | None:
    """Which parameters matter most, in words; None for too few trials."""
    found = importances(trials)
    if not found:
        return None
    first = ", ".join(f"{key} {share:.0%}" for key, share in list(found.items())[:3])
    others = list(found.values())[3:]
    rest = f", the other {len(others)} {sum(others):.0%}" if others else ""
    return (
        f"{trials.name}: what sets the best tenth of the trials apart (PED-ANOVA, in-sample):"
        f" {first}{rest}"
    )


def _searched(document: Mapping[str, Any]) -> list[str]:
    """Names in the paper's order, BV last."""
    names = list(document["space"]["searched"])
    return sorted(names, key=lambda name: name == "bonus_value")


def _theirs(document: Mapping[str, Any], names: Sequence[str], score: str) -> list[str]:
    entry = load_published()[document["run"]]
    values = entry["parameters"]
    # The matrices give more digits than the paper prints.
    scores = scores_from_confusion(np.asarray(entry["model"]["confusion"]))
    theirs = {"accuracy": scores.accuracy, "f1": scores.mean_f1}.get(score)
    return [
        document["name"],
        "paper",
        *(_value(values.get(name)) for name in names),
        f"{theirs:.3f}" if theirs is not None else f"{entry['model']['metrics'][score]:.2f}",
        "-",
        "-",
    ]


def _value(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _cell(
    section: Mapping[str, Any] | None, score: str, subset: str = "all_frames", sign: str = ""
) -> str:
    """A score with its interval, of a part of study.json; a dash where it is not there."""
    scores = (section or {}).get(subset) or {}
    interval = (scores.get("intervals") or {}).get(score)
    return with_interval(scores.get(score), interval, f"{sign}.3f")
