"""The command `egolane label`: lane labels of a recording, and what a human should look at."""

from __future__ import annotations

from pathlib import Path

import click

from egolane_pgm.api.labels import EXPERIMENT, LabelResult, review_rows
from egolane_pgm.api.labels import label as label_recording
from egolane_pgm.cli import options
from egolane_pgm.cli.options import write_json
from egolane_pgm.drive import name_of, named_files
from egolane_pgm.experiment import load_experiment
from egolane_pgm.labelling import BELOW
from egolane_pgm.report.tables import Table, page, score_text
from egolane_pgm.results import SCHEMA_VERSION, check_writable
from egolane_pgm.tools.files import check_not_read
from egolane_pgm.types import InputError

#: How many stretches of the review list are printed.
SHOWN = 10


@click.command()
@click.argument("recording", required=False)
@click.option(
    "--n-lanes", type=int, help="Number of lanes of the road; needed without --experiment."
)
@click.option(
    "--experiment",
    type=click.Path(dir_okay=False),
    help=f"What labels it.  [default: experiments/{EXPERIMENT}]",
)
@options.overrides("Override a key of the experiment, e.g. recording.frame_rate=25.")
@click.option(
    "--below",
    type=click.FloatRange(0, 1),
    default=BELOW,
    show_default=True,
    help="Frames whose label has a smaller probability are looked at.",
)
@click.option("--ground-truth", metavar="FILE", help="Annotation to score the labels with.")
@options.of_recording
@click.option("--out", type=click.Path(file_okay=False), help="Folder of the labels.")
@click.option("--no-figures", is_flag=True, help="Draw nothing.")
@options.tables
@options.json_file
def label(
    recording: str | None,
    n_lanes: int | None,
    experiment: str | None,
    overrides: tuple[str, ...],
    below: float,
    ground_truth: str | None,
    camera: str | None,
    detector: str | None,
    frame_id: str | None,
    out: str | None,
    no_figures: bool,
    style: str,
    wide: bool,
    json_file: Path | None,
) -> None:
    """Label the lanes of a RECORDING, and list the frames that a human should look at.

    The labels are made from the whole recording (smoothed beliefs, lane width of all frames), and
    no label is needed for that. labels.txt in the output folder is a ground-truth file as `egolane
    run --ground-truth` reads it; review.csv and figures/ are for whoever checks it. Without
    RECORDING the --experiment's own is labelled.
    """
    if "" in (recording, ground_truth, camera, out, experiment):
        raise InputError("label: a file or folder that is named is empty")
    name = name_of(recording or experiment or "recording")
    directory = Path(out or Path("results") / f"{name}_labels")
    check_writable(directory)
    if json_file:
        files = [Path(f) for f in (recording, ground_truth, camera) if f and f != "none"]
        named = [] if experiment is None else named_files(load_experiment(experiment, overrides))
        check_not_read(json_file, [*files, *named])
    found = label_recording(
        recording,
        n_lanes=n_lanes,
        experiment=experiment,
        overrides=overrides,
        ground_truth=ground_truth,
        below=below,
        camera=camera,
        detector=detector,
        frame_id=frame_id,
    )
    found.save(directory, figures=not no_figures)
    # The file is written before anything is printed, because a reader may close the pipe.
    if json_file:
        write_json(json_file, _document(found))
    click.echo(page(_parts(found), style, wide))
    click.echo(f"\nlabels: {directory / 'labels.txt'}", err=style != "markdown")


def _document(found: LabelResult) -> dict[str, object]:
    return {
        "schema_version": SCHEMA_VERSION,
        "name": found.name,
        "n_lanes": found.labels.run.experiment.n_lanes,
        "frames": len(found),
        "below": found.labels.below,
        "reviewed": float(found.labels.is_reviewed.mean()),
        "review": found.review.to_dict("records"),
        "doubted": found.doubted.to_dict("records"),
        "warnings": found.notes,
        "scores": found.scores,
    }


def _parts(found: LabelResult) -> list[str | Table]:
    for note in found.notes:
        options.warn(note)
    known = "labels know the whole recording: for the frames themselves, not for a causal score"
    parts: list[str | Table] = [f"{found.title()}\n{known}"]
    worst = found.labels.worst[:SHOWN]
    if worst:
        parts.append(f"to review, those first in which most frames may be wrong ({len(worst)} of"
                     f" {len(found.labels.review)}):")  # fmt: skip
        parts.append(Table(*review_rows(worst)))
    return parts + (score_parts(found) if found.scores else [])


def score_parts(found: LabelResult) -> list[str | Table]:
    """What the ground truth says about the labels."""
    scores = found.scores
    which = "trusted, " if scores["trusted_only"] else ""
    rows = [
        [f"{float(share):.0%}", score_text(right, 4)] for share, right in scores["surest"].items()
    ]
    lines = [
        f"share on the review list: {score_text(scores['reviewed'])}",
        "right of those that are neither on it nor labelled as crossing:"
        f" {score_text(scores['unreviewed'], 4)} ({scores['wrong_unreviewed']} wrong)",
        f"crossing frames: precision {score_text(scores['crossing_precision'])},"
        f" recall {score_text(scores['crossing_recall'])}",
    ]
    n_doubted = len(found.doubted)
    if n_doubted:
        lines.append(f"{n_doubted} stretch(es) in which a sure label contradicts it: doubted.csv")
    return [
        f"{scores['frames_scored']} {which}annotated frames (crossing ones are not scored):",
        Table(["surest frames", "right"], rows),
        "\n".join(lines),
    ]
