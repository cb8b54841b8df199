"""The command `egolane compare`."""

from __future__ import annotations

from pathlib import Path

import click

DEFAULT_GRAPHS = "sensor_failure,wor_on_lane,no_wor,lane_only"
TITLES = {"accuracy": "Accuracy", "f1": "F1 (mean over lanes)", "log_loss": "Log-loss (all frames)"}


@click.command()
@click.option("--graphs", default=DEFAULT_GRAPHS, show_default=True, help="Names or files.")
@click.option("--runs", default="1-10", show_default=True, help="Runs of the paper, e.g. 1-5,7.")
@click.option(
    "--parameters",
    "which",
    type=click.Choice(["recovered", "published"]),
    default="recovered",
    show_default=True,
)
@click.option("--json", "json_file", type=click.Path(dir_okay=False), metavar="FILE")
def compare(graphs: str, runs: str, which: str, json_file: str | None) -> None:
    """The paper's runs under several graphs, with the paper's parameters."""
    from tqdm import tqdm

    from egolane_pgm import compare as comparing
    from egolane_pgm.report import tables
    from egolane_pgm.reproduce import parse_runs
    from egolane_pgm.results import write_json

    names = [name.strip() for name in graphs.split(",") if name.strip()]
    numbers = parse_runs(runs)
    bar = tqdm(numbers, desc="runs", unit="run", leave=False, disable=None)
    compared = [comparing.compare_graphs(number, names, which) for number in bar]
    for key, title in TITLES.items():
        header, rows = comparing.compare_rows(compared, key)
        click.echo(f"{title}\n\n{tables.markdown(header, rows)}\n")
    click.echo(
        f"Parameters: the paper's ({which}), as far as a graph has them; in-sample: the authors"
        " tuned them for sensor_failure on these very frames."
    )
    if "wor_on_lane" in names and "sensor_failure" in names:
        click.echo(
            "wor_on_lane is sensor_failure until its p3 and p4 differ from lane to lane; the paper"
            " has one value of each."
        )
    if json_file:
        write_json(Path(json_file), comparing.compare_json(compared, which))
