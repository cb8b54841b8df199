"""The command `egolane explore`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.kits.drives import command, done

WORDS = ("explore", "quickstart", "--set", "recording.frames=[0,600]")


def test_edges_are_judged_and_the_best_graph_runs(tmp_path: Path) -> None:
    out = tmp_path / "found"
    given = ("--edge", "Lane -> WOR", "--edge", "WOR repeats itself", "--out", out)
    output = done(*WORDS, "--set", "fit.folds=2", *given)
    found = pd.read_csv(out / "edges.csv")
    assert set(found["edge"]) == {"Lane -> WOR", "WOR repeats itself"}
    assert found["gain"].is_monotonic_decreasing
    assert "gain in held-out log-loss of Lane" in output.stdout
    for name in ("best.png", "best.bif", "structures.csv"):
        assert (out / name).stat().st_size
    for graph in ("best.graph.yaml", "best.bif"):
        words = ("--graph", out / graph, "--no-figures", "--out", tmp_path / graph)
        assert "right in" in done("run", *WORDS[1:4], *words).stdout


def test_a_repeated_command_fits_nothing_again(tmp_path: Path) -> None:
    """In another process, which has another order of sets."""
    words = (*WORDS[:3], "recording.frames=[0,60]", "--set", "fit.folds=2", "--out", str(tmp_path))
    words += ("--edge", "Lane -> WOR", "--edge", "WOR(t-1) -> WOR")
    done(*words)
    kept = set(tmp_path.glob("tried/*.parquet"))
    code = "import sys; from egolane_pgm.command import egolane; egolane(sys.argv[1:])"
    subprocess.run([sys.executable, "-c", code, *words], check=True, capture_output=True)
    # Four structures or three, in two folds and in all frames.
    assert len(kept) in (3 * 3, 4 * 3)
    assert set(tmp_path.glob("tried/*.parquet")) == kept


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--edge", "Lane - WOR"), "edge 'Lane - WOR': no node"),
        (("--judge", "acuracy"), "--judge: unknown score 'acuracy' (did you mean 'accuracy'?)"),
        (("--node", "Occlusion"), "--node: 'Occlusion' is not NEW_NAME=SIZE, e.g. Occlusion=2"),
        (("--node", "Lane=3"), "--node: 'Lane=3' is not NEW_NAME=SIZE"),
    ],
)
def test_a_bad_edge_node_or_judge_is_refused_in_one_line(
    tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    result = command(*WORDS, *words, "--out", tmp_path / "x")
    assert result.exit_code == 2
    assert message in result.stderr.splitlines()[-1]
