"""The text and the figures of a study."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from egolane_pgm.scoring.bootstrap import BLOCK_FRAMES, LEAST_BLOCKS
from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.tools.files import read_parquet, reading
from egolane_pgm.types import InputError
from egolane_pgm.views.result_text import drive_parts
from egolane_pgm.views.style import (
    DETECTOR_COLOUR,
    FAINT,
    MODEL_COLOUR,
    new_figure,
    write_figures,
)
from egolane_pgm.views.tables import (
    LOG_EVIDENCE,
    Table,
    cell,
    page,
    score_table,
    table,
    with_interval,
)

if TYPE_CHECKING:
    from egolane_pgm.studies.explore import Exploration
    from egolane_pgm.studies.study import Study

_DOTS = "#8aa9c0"


# --- text ----------------------------------------------------------------------------------------


def study_title(study: Study) -> str:
    """A study in one line: method, trials, and accuracy in-sample and held out."""
    more = len(study.experiments) - 1
    parts = [f"{study.name!r}{f' and {more} more' if more else ''}: {study.method}"]
    parts += [f"{study.n_trials} trials"] if study.n_trials else []
    results = {"in-sample": study.in_sample, "held out": study.held_out}
    accuracy = [
        f"{result.scores['model']['accuracy']:.3f} {name}"
        for name, result in results.items()
        if result is not None and "model" in result.scores
    ]
    parts.append(f"accuracy {', '.join(accuracy)}" if accuracy else "no ground truth")
    return ", ".join(parts)


def study_text(study: Study, style: str) -> str:
    """The output of `egolane tune` and `learn`: scores in-sample and held out, and the best fit."""
    parts: list[str | Table] = [study_title(study)]
    scores = {"in-sample": study.in_sample.scores}
    folds = []
    held_out = study.held_out
    if held_out is not None:
        scores["held out"] = held_out.scores
        folds = held_out.run["fitted"]
        parts.append(f"held out: {len(folds)} folds, each scored with a fit to the others")
    if "model" in study.in_sample.scores:
        parts.append(score_table({name: each["model"] for name, each in scores.items()}))
    if held_out is not None and "drive" in held_out.frames:
        parts += drive_parts(held_out)
    evidence = [f"{cell(each['mean_log_evidence'], 4)} {name}" for name, each in scores.items()]
    parts.append(f"mean log evidence per frame: {', '.join(evidence)}\n({LOG_EVIDENCE})")
    values = {name: value for name, value in study.fitted.items() if np.ndim(value) == 0}
    if values:
        before = study.experiments[0].parameters
        columns = {"before": [cell(before.get(name)) for name in values]}
        columns["best"] = [cell(value) for value in values.values()]
        if folds:
            columns["folds"] = [_range([f[name] for f in folds if name in f]) for name in values]
        posterior = study.posterior.set_index("name") if len(study.posterior) else None
        if posterior is not None:
            known = posterior.index.intersection(list(values))
            ranges = {name: _ends(posterior.loc[name]) for name in known}
            columns["posterior (95 %)"] = [ranges.get(name, "") for name in values]
        parts.append(table(pd.DataFrame(columns, index=pd.Index(values, name="parameter"))))
        if posterior is not None:
            scores_of = [
                f"{name} {_ends(posterior.loc[name])}" for name in ("accuracy", "log_loss")
            ]
            parts.append(
                "posterior of a fit to the labels (Laplace): over it, in-sample,"
                f" {', '.join(scores_of)}"
            )
    objectives = list(study.settings.get("objectives", ()))
    if len(objectives) > 1:
        front = pareto_front(study.trials, objectives).set_index("number").rename_axis("trial")
        best = {int((_sign(name) * front[name]).argmax()) for name in objectives}
        between = np.linspace(0, len(front) - 1, 10 - len(best)).astype(int).tolist()
        shown = sorted({*best, *between})
        parts.append(f"Pareto front (in-sample), {len(shown)} of its {len(front)} trials:")
        parts.append(table(front[objectives].iloc[shown]))
    if len(study.profile):
        parts.append(f"profile of {objectives[0]} (in-sample), others searched again:")
        parts.append(profile_table(study.profile, study.posterior))
    tables = [name for name in study.fitted if name not in values]
    if tables:
        parts.append(f"fitted tables and lists: {', '.join(tables)}")
    return page(parts, style)


def _range(values: Sequence[Any]) -> str:
    """The range of a parameter's values in the folds, or its different words."""
    if all(isinstance(each, (int, float)) for each in values):
        return " to ".join(dict.fromkeys(cell(end) for end in (min(values), max(values))))
    return ", ".join(dict.fromkeys(map(str, values)))


def pareto_front(trials: pd.DataFrame, objectives: Sequence[str]) -> pd.DataFrame:
    """The complete trials that no other one beats in every objective, ordered by the first."""
    done = trials[trials["state"] == "COMPLETE"].drop_duplicates(objectives)
    values = done[objectives].to_numpy() * list(map(_sign, objectives))
    beaten = [((values >= row).all(axis=1) & (values > row).any(axis=1)).any() for row in values]
    first = objectives[0]
    front = done[~np.array(beaten)]
    return front.sort_values(first, ascending=_sign(first) < 0, kind="stable")


def _ends(row: Any) -> str:
    """An interval of a posterior as text."""
    return f"[{cell(float(row['low']))}, {cell(float(row['high']))}]"


def profile_table(profile: pd.DataFrame, posterior: pd.DataFrame) -> Table:
    """A row per parameter: its best value, and the range of the values that are not ruled out.

    - posterior: of the same parameters by a fit to the labels; empty for none. A parameter whose
      interval has a value that is ruled out, or whose best value lies outside, is marked.
    """
    rows = {}
    intervals = posterior.set_index("name") if len(posterior) else posterior
    for name, found in profile.groupby("parameter", sort=False):
        value = found["value"]
        kept = found["value"][~found["is_ruled_out"]]
        words = f"{cell(kept.min())} to {cell(kept.max())}"
        if (kept.min(), kept.max()) == (value.min(), value.max()):
            words = "any value" if found["low"].notna().any() else "unknown: too few frames"
        elif kept.min() == value.min():
            words = f"at most {cell(kept.max())}"
        elif kept.max() == value.max():
            words = f"at least {cell(kept.min())}"
        best = value[found["difference"].idxmin()]
        rows[name] = {"best": best, "not ruled out (95 %)": words}
        if name in intervals.index:
            low, high = (float(intervals.loc[name, end]) for end in ("low", "high"))
            is_apart = kept.max() < low or kept.min() > high
            differ = "yes" if is_apart or not low <= best <= high else ""
            rows[name] |= {"posterior (95 %)": _ends(intervals.loc[name]), "they differ": differ}
    return table(pd.DataFrame.from_dict(rows, "index").rename_axis("parameter"))


#: What structures were fitted to, and the question that the answer belongs to.
_QUESTIONS = {
    "log_loss": (
        "to the labels",
        "which edge helps the answer; for which edge is in the data, judge by bic",
    ),
    "log_evidence": (
        "by EM",
        "which edge is in the data, if BIC or log evidence judges; for which edge helps the answer,"
        " judge by log_loss",
    ),
}


def exploration_text(found: Exploration, style: str) -> str:
    """The output of `egolane explore`: the edges, and how sure they are."""
    edges = found.edges
    gain = found.gain
    fitted, question = _QUESTIONS[found.objective]
    forms = {"gain": "+.3f", "over_drives": "+.3f", "selected": ".2f"}
    removed = np.where(edges["change"] == "remove", "without ", "")
    passing = int(edges["passes"].sum())
    edges = edges.set_index(pd.Index(removed + edges["edge"], name="edge"))
    edges["passes"] = np.where(edges["passes"], "yes", "")
    shown = [["gain", "gain_low", "gain_high", "passes", "selected"]]
    if edges["over_drives_low"].notna().any():
        shown.append(["over_drives", "over_drives_low", "over_drives_high", "drives"])
    interval = with_interval(gain["gain"], [gain["gain_low"], gain["gain_high"]], "+.3f")
    about = f"gain {interval}, {gain['free_parameters']:+} free parameters\n  (chosen by its score"
    about += " on these frames, which is therefore optimistic)"
    chance = f"chance gives the best of them a gain of {found.by_chance:+.3f}"
    if found.by_chance == math.inf:
        chance = f"fewer than {LEAST_BLOCKS} blocks of {BLOCK_FRAMES} frames do not tell gains from"
        chance += " chance"
    about = about if found.best else "the graph to start from: no gain is beyond chance"
    parts: list[str | Table] = [
        f"{len(found.structures)} graphs were fitted {fitted}; {found.judge}",
        "each edge alone [95 % interval over blocks of frames, or over drives], and the share of"
        " resamples in which it passes:",
        *[table(edges[columns], forms) for columns in shown],
        f"{passing} of {len(edges)} edges pass: {chance}",
        f"best set: {gain['changes']}\n  {about}",
        f"The question was {question}.",
    ]
    return page(parts, style)


# --- figures -------------------------------------------------------------------------------------


def draw_study(
    directory: str | Path, target: str | Path | None = None, style: str = "png"
) -> list[Path]:
    """Draw the history, the profile and the posterior of a study.

    - directory: as `Study.save` writes it. target: default `figures/` in it.
    - style: png, pdf or svg.

    Raises InputError for a directory without a search or a posterior, and for one without a
    complete trial.
    """
    place = Path(directory)
    figures: dict[str, Callable[[], Figure]] = {}
    kept = {
        each: read_parquet(place / f"{each}.parquet")
        for each in ("profile", "posterior")
        if (place / f"{each}.parquet").is_file()
    }
    if "posterior" in kept:
        figures["posterior"] = lambda: posterior_figure(kept["posterior"], place.name)
    if "posterior" not in kept or (place / "trials.parquet").is_file():
        document, trials = read_trials(place)
        name = f"{document['name']}: {len(trials)} trials"
        profile = kept.get("profile", pd.DataFrame({"parameter": [], "score": []}))
        figures["history"] = lambda: history_figure(trials, document, name)
        figures["profile"] = lambda: profile_figure(
            trials, document, name, profile, kept.get("posterior")
        )
        if len(document["settings"]["objectives"]) > 1:
            figures["front"] = lambda: front_figure(trials, document, name)
    return write_figures(figures, Path(target or place / "figures"), style)


def read_trials(directory: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """The content of study.json, and the complete trials, the first objective as `score`."""
    if not (directory / "trials.parquet").is_file():
        raise InputError(
            f"{directory}: is not the directory of a search; draw the results of another study with"
            f" `egolane plot {directory / 'held_out'}`"
        )
    with reading(directory, "a study"):
        document = json.loads((directory / "study.json").read_text())
        trials = pd.read_parquet(directory / "trials.parquet")
        trials = trials[trials["state"] == "COMPLETE"].copy()
        trials["score"] = trials[document["settings"]["objectives"][0]]
    if trials.empty:
        raise InputError(f"{directory}: has no complete trial to draw")
    return document, trials.sort_values("number", ignore_index=True)


def history_figure(trials: pd.DataFrame, document: Mapping[str, Any], title: str) -> Figure:
    """Draw the score of each trial, the best so far, and the held-out score."""
    score, sign = _score(document)
    best = sign * (sign * trials["score"]).cummax()
    held_out = ((document["held_out"] or {}).get("model") or {}).get(score)
    figure = new_figure(8, 3.2, title)
    ax = figure.subplots()
    ax.plot(trials["number"], trials["score"], ".", ms=4, color=_DOTS, label="trial")
    label = f"best so far: {best.iloc[-1]:.3f} (in-sample)"
    ax.plot(trials["number"], best, color=MODEL_COLOUR, lw=1.5, ds="steps-post", label=label)
    if held_out is not None:
        label = f"held out: {held_out:.3f}"
        ax.axhline(held_out, color=DETECTOR_COLOUR, ls=(0, (4, 2)), label=label)
    low, high = _limits(trials["score"], sign, held_out)
    n_outside = int((~trials["score"].between(low, high)).sum())
    ax.set(ylim=(low, high), ylabel=score.replace("_", " "))
    ax.set_xlabel(f"trial ({n_outside} of {len(trials)} outside the axis)")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def profile_figure(
    trials: pd.DataFrame,
    document: Mapping[str, Any],
    title: str,
    profile: pd.DataFrame,
    posterior: pd.DataFrame | None = None,
) -> Figure:
    """Draw the score over each parameter, and the best values of all frames and of the folds.

    - profile: of the parameters that have one; the others get none. Values that are not ruled out
      are shaded.
    - posterior: of a fit to the labels; its intervals are bars below.
    """
    score, sign = _score(document)
    names = list(document["settings"]["searched"])
    best = trials.loc[(sign * trials["score"]).idxmax()]
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure = new_figure(max(2.2 * columns + 0.6, 5), 0.8 + 1.8 * rows, title)
    axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for ax in axes.flat[len(names) :]:
        ax.remove()
    # The profile may find a better point than the trials.
    top = sign * max(sign * score for score in (best["score"], *profile["score"]))
    low, high = _limits(trials["score"], sign, top)
    for ax, name in zip(axes.flat, names, strict=False):
        values = trials[name]
        if values.dtype.kind in "if":
            is_whole = values.dtype.kind == "i"
            ax.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10], integer=is_whole))
        ax.plot(values, trials["score"], ".", ms=3, color=_DOTS, label="trial")
        ax.plot([best[name]], [best["score"]], "o", color=MODEL_COLOUR, ms=6, label="best")
        folds = [fold[name] for fold in document["folds"] or () if name in fold]
        if folds:
            look: Any = {"color": DETECTOR_COLOUR, "ms": 12, "mew": 1.5, "zorder": 3}
            ax.plot(folds, [low] * len(folds), "|", label="best of a fold (no score)", **look)
        found = profile[profile["parameter"] == name.partition("[")[0]]
        if len(found):
            ends = [top - sign * found[end].astype(float) for end in ("low", "high")]
            kept = found["value"][~found["is_ruled_out"]]
            look = {"color": MODEL_COLOUR, "label": "others searched again, 95 % interval"}
            ax.plot(found["value"], found["score"], lw=1.2, **look)
            ax.fill_between(found["value"], *ends, color=MODEL_COLOUR, alpha=0.25, lw=0)
            ax.axvspan(kept.min(), kept.max(), color=FAINT, alpha=0.4, lw=0, label="not ruled out")
        if posterior is not None and name in set(posterior["name"]):
            ends = posterior.set_index("name").loc[name, ["low", "high"]]
            look = {"color": DETECTOR_COLOUR, "lw": 4, "alpha": 0.5, "solid_capstyle": "butt"}
            look |= {"label": "posterior, fit to the labels"}
            ax.plot(ends.astype(float), [low, low], **look)
        ax.set(xlabel=name, ylim=(low, high))
    for ax in axes[:, 0]:
        ax.set_ylabel(f"{score.replace('_', ' ')} (in-sample)")
    entries = max((ax.get_legend_handles_labels() for ax in figure.axes), key=lambda e: len(e[1]))
    figure.legend(*entries, loc="outside lower left", ncols=3)
    return figure


def posterior_figure(posterior: pd.DataFrame, title: str) -> Figure:
    """Draw the posterior of each number: the fit and the 95 % interval."""
    figure = new_figure(6, 1.2 + 0.28 * len(posterior), f"{title}: fit to the labels")
    ax = figure.subplots()
    rows = np.arange(len(posterior))
    look: Any = {"color": MODEL_COLOUR, "alpha": 0.4, "lw": 5}
    ax.hlines(rows, posterior["low"], posterior["high"], label="95 % interval (Laplace)", **look)
    ax.plot(posterior["value"], rows, "o", color=MODEL_COLOUR, ms=5, label="fit")
    ax.set_yticks(rows, posterior["name"].str.replace("_", " "))
    ax.set_xlim(left=0)
    ax.set_xlabel("sigma in lanes, p as a probability; accuracy and log-loss (nats) in-sample")
    ax.invert_yaxis()
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def front_figure(trials: pd.DataFrame, document: Mapping[str, Any], title: str) -> Figure:
    """Draw all trials in the first objective and each other one, with the Pareto front."""
    objectives = document["settings"]["objectives"]
    front = pareto_front(trials, objectives)
    limits = [_limits(trials[each], _sign(each), *front[each]) for each in objectives]
    first, *others = objectives
    figure = new_figure(max(3.2 * len(others) + 0.6, 5), 3.6, title)
    axes = figure.subplots(1, len(others), squeeze=False)[0]
    for ax, name, ylim in zip(axes, others, limits[1:], strict=True):
        ax.plot(trials[first], trials[name], ".", ms=4, color=_DOTS, label="trial")
        ax.plot(front[first], front[name], ".", ms=6, color=MODEL_COLOUR, label="Pareto front")
        ax.plot(*front.iloc[0][[first, name]], "s", color=DETECTOR_COLOUR, label="chosen")
        ax.set(xlim=limits[0], ylim=ylim, ylabel=name.replace("_", " "))
        ax.set_xlabel(f"{first.replace('_', ' ')} (in-sample)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _score(document: Mapping[str, Any]) -> tuple[str, int]:
    """The name of the score and its `_sign`."""
    name = document["settings"]["objectives"][0]
    return name, _sign(name)


def _sign(score: str) -> int:
    """1 for a score that is maximised, else -1."""
    return 1 if SCORES[score].is_maximised else -1


def _limits(scores: pd.Series, sign: int, *others: float | None) -> tuple[float, float]:
    """The range of the score axis, without the worst trials."""
    gain = sign * scores
    shown = [sign * gain.max(), sign * gain.quantile(0.3), *(v for v in others if v is not None)]
    margin = 0.08 * float(np.ptp(shown)) or 0.01
    return min(shown) - margin, max(shown) + margin
