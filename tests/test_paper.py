"""The paper's 100 printed scores, from its recordings; test_frozen has the matrices."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm import paper as paper
from egolane_pgm.loading import load_experiment
from egolane_pgm.paper import Reproduced
from egolane_pgm.recordings import topics
from tests.conftest import needs_compiler
from tests.kits.drives import done, refused, run, short_drive, write_drive
from tests.reference import counting
from tests.reference import inference as reference

RUNS = range(1, 11)

#: The scores that the paper prints.
SCORES = ("accuracy", "precision", "recall", "f1", "log_loss")

#: Frames off in the model matrices with the parameters as printed, truncated to three decimals.
PUBLISHED_OFF = (3, 15, 16, 9, 39, 2, 1, 2, 1, 65)

#: The published parameters are truncated to three decimals: the value used was below this higher.
TRUNCATION = 0.001

#: Scores of the model that these parameters move past a second digit, up to the printed one.
PUBLISHED_BELOW = {(2, "precision"), (2, "log_loss"), (3, "log_loss")}


@pytest.fixture(scope="module", autouse=True)
def read_once() -> Iterator[None]:
    """Let each recording be read once, which takes longer than its run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(topics, "fields_of", cache(topics.fields_of))
        yield


@pytest.fixture(scope="module")
def recovered(recordings: Path) -> list[Reproduced]:
    return [paper.reproduce_run(number, "recovered") for number in RUNS]


@pytest.fixture(scope="module")
def published(recordings: Path) -> list[Reproduced]:
    return [paper.reproduce_run(number, "published") for number in RUNS]


@needs_compiler
def test_plain_numpy_gives_the_same_on_the_first_and_the_last_run(
    recordings: Path, recovered: list[Reproduced]
) -> None:
    for ours in recovered[::9]:
        found = ours.run
        [log] = found.lines.values()
        seen = counting.evidence(log, found.model.n_lanes, found.model.parameters)
        right = reference.filter_beliefs(found.model.compiled, seen, found.experiment.filter)
        np.testing.assert_allclose(found.node("Lane"), right.lane, rtol=0, atol=1e-10)


@needs_compiler
def test_the_printed_parameters_are_as_far_off_as_truncation_makes_them(
    published: list[Reproduced],
) -> None:
    assert [r.detector_frames_off for r in published] == [0] * 10
    assert tuple(r.model_frames_off for r in published) == PUBLISHED_OFF
    assert sum(PUBLISHED_OFF) == 153


def agrees(ours: float, printed: float) -> bool:
    """Whether a score, truncated to two digits as the paper does it, is the printed one."""
    return int(np.floor(ours * 100 + 1e-9)) == round(printed * 100)


@needs_compiler
@pytest.mark.parametrize(("which", "below"), [("recovered", set()), ("published", PUBLISHED_BELOW)])
def test_all_100_printed_scores_are_ours_truncated(
    which: str, below: set[tuple[int, str]], request: pytest.FixtureRequest
) -> None:
    compared = 0
    differ = set()
    for r in request.getfixturevalue(which):
        for ours, theirs in (("detector", "detector_only"), ("model", "model")):
            for key in SCORES:
                value, printed = r.run.scores[ours][key], r.entry[theirs]["metrics"][key]
                compared += 1
                if not agrees(value, printed):
                    assert round(value, 2) == printed
                    assert ours == "model"
                    differ.add((r.number, key))
    assert compared == 100
    assert differ == below


def test_the_experiments_of_the_paper_have_the_parameters_of_the_published_file() -> None:
    for number, entry in paper.load_published().items():
        experiment = load_experiment(paper.paper_experiment(number))
        assert experiment.parameters == entry["parameters"], number
        assert experiment.n_lanes == entry["n_lanes"]
        assert experiment.tuned_on == "same_frames"
        assert np.shape(entry["model"]["confusion"]) == (entry["n_lanes"] + 1, entry["n_lanes"])


def test_what_was_recovered_lies_in_the_box_of_the_truncated_values() -> None:
    for number, entry in paper.load_published().items():
        used = paper.parameters_for(entry, "recovered")
        for name, printed in entry["parameters"].items():
            if name == "bonus_value":
                assert used[name] == printed
            else:
                assert printed <= used[name] < printed + TRUNCATION, (number, name)


@pytest.mark.parametrize(
    ("text", "runs"), [("1-3,7", [1, 2, 3, 7]), ("10", [10]), (" 2 , 2-4", [2, 3, 4])]
)
def test_runs_are_written_as_numbers_and_ranges(text: str, runs: list[int]) -> None:
    assert paper.parse_runs(text) == runs


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1-", "write numbers and ranges"),
        ("a", "write numbers and ranges"),
        ("5-11", "the paper has runs 1 to 10"),
        ("5-3", "write numbers and ranges"),
    ],
)
def test_other_runs_are_refused(text: str, said: str) -> None:
    assert said in refused("reproduce", "--runs", text)


def test_without_the_recordings_it_is_said_how_to_get_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EGOLANE_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    said = refused("reproduce", "--runs", "2")
    assert "run02_italy_sl.yaml: recording.path: " in said
    assert "rle/special.issue.italy.stereo" in said
    assert "egolane data fetch" in said
    assert "EGOLANE_DATA" in said


N_FRAMES = 400


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """published.yaml and the experiment of run 2, found where the paper's would be."""
    folder = tmp_path / "experiments" / "paper"
    truth = run(shutil.move(write_drive(folder, N_FRAMES, name="run02"), folder / "run02_x.yaml"))
    entry: dict[str, Any] = {"run": 2, "n_lanes": 3, "recovered": {"parameters": {}}}
    for ours, theirs in (("detector", "detector_only"), ("model", "model")):
        scores = truth.scores[ours]
        entry[theirs] = {
            "confusion": scores["confusion"],
            "metrics": {key: round(scores[key], 2) for key in SCORES},
        }
    text = "runs:\n  - run: 2\n" + "".join(
        f"    {key}: {json.dumps(value)}\n" for key, value in entry.items() if key != "run"
    )
    (folder / "published.yaml").write_text(text)
    monkeypatch.setattr(paper, "experiments_folder", lambda: tmp_path / "experiments")


@pytest.mark.usefixtures("stand_in")
def test_the_commands_print_and_compare(tmp_path: Path) -> None:
    target = tmp_path / "all.json"
    words = ("--runs", "2", "--out", tmp_path / "kept", "--json", target)
    shown = done("reproduce", *words).stdout
    document = json.loads(target.read_text())
    assert document["total_frames_off"] == 0
    total = 2 * document["runs"][0]["model"]["frames_scored"]
    assert total == 2 * int((~short_drive(N_FRAMES).truth["is_crossing"]).sum())
    assert f"\n0 of {total} classified frames off" in shown
    rows = [line for line in shown.splitlines() if line.startswith("| 2 ")]
    assert max(map(len, rows)) < 80
    assert len(rows) == 2
    assert (tmp_path / "kept" / "run02" / "run.json").is_file()
    latex = done("reproduce", "--runs", "2", "--format", "latex").stdout
    assert latex.startswith(r"\begin{tabular}")
