"""How the objects that the verbs return show themselves, and what they are turned into."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from egolane_pgm.report.comparison_tables import trusted_or_all
from egolane_pgm.report.tables import score_rows, tuned_on_text, with_interval
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from egolane_pgm.results import Result


def how_tuned(found: Mapping[str, Any]) -> str:
    """On which frames the parameters were tuned, and whether a belief uses earlier frames only."""
    return tuned_on_text(found) + (", causal" if all(found["causal"].values()) else "")


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


def as_dataset(frame: pd.DataFrame) -> xr.Dataset:
    """A frame as a data set of xarray. Raises InputError where xarray is not installed."""
    found: xr.Dataset = xarray().Dataset.from_dataframe(frame)
    return found


def xarray() -> Any:
    """The package xarray. Raises InputError where it is not installed."""
    try:
        import xarray
    except ImportError:
        raise InputError("to_xarray: needs xarray, `pip install xarray`") from None
    return xarray


def scored(result: Result) -> dict[str, Any]:
    """The scores of the model, and of the detector alone where they are known."""
    scores = result.scores
    found: dict[str, Any] = {who: scores[who] for who in ("model", "detector") if who in scores}
    if "held_out" in scores:
        # A comparison scores what it held out, over several choices of frames.
        found["model"] = trusted_or_all(scores["held_out"]["scores"])
    return found


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
