"""What the figures of a study show equals the trials that it leaves behind."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from matplotlib.figure import Figure
from pyarrow import parquet

from egolane_pgm.types import InputError
from egolane_pgm.views import study_figures as tuning
from egolane_pgm.views import study_trials as numbers
from egolane_pgm.views.style import write_figure
from tests.kits.drives import done, refused

SCORES = [0.5, 0.8, 0.796, 0.7, 0.795, None, 0.8]
COLUMNS: dict[str, list[Any]] = {
    "sigma1": [0.1, 0.3, 0.5, 2.9, 0.2, 1.0, 0.9],
    "bonus_value": [0, 7, 9, 1, 8, 2, 7],
    "normal": ["density", "cells", "cells", "density", "cells", "cells", "cells"],
}
SPACE = {"sigma1": [3e-6, 3.0], "bonus_value": [0.0, 9.0], "normal": ["density", "cells", "other"]}


def write_study(folder: Path, scores: list[float | None] = SCORES, **changes: Any) -> Path:
    """A study directory with seven trials, one of which failed."""
    folder.mkdir(exist_ok=True)
    content = {
        "schema_version": 1,
        "name": "tiny",
        "run": None,
        "tuning": {"objective": ["accuracy"]},
        "space": {"searched": SPACE},
        "best": {"point": {"sigma1": 0.3}, "values": {"accuracy": 0.66}, "trials": 6},
        "experiments": [{"parameters": {"sigma1": 0.25, "bonus_value": 3.0, "normal": "other"}}],
        "held_out": {
            "all_frames": {"accuracy": 0.61},
            "studies": [{"point": {"sigma1": 0.4, "bonus_value": 8, "normal": "cells"}}],
        },
        **changes,
    }
    (folder / "study.json").write_text(json.dumps(content))
    name = content["tuning"]["objective"][0]
    table = {"number": list(range(len(scores))), f"{name}_in_sample": scores, **COLUMNS}
    parquet.write_table(pa.table(table), folder / "trials.parquet")
    return folder


def made(columns: dict[str, list[float]], name: str = "accuracy") -> numbers.Trials:
    """Trials of parameters between 0 and 1, and their `score`."""
    scores = columns.pop("score")
    content = {
        "name": "made",
        "tuning": {"objective": [name]},
        "space": {"searched": {key: [0.0, 1.0] for key in columns}},
    }
    table = {"number": range(len(scores)), f"{name}_in_sample": scores, **columns}
    return numbers.trials_of(content, table, "made")


def test_failed_trials_are_left_out_and_the_first_of_equal_ones_is_the_best(tmp_path: Path) -> None:
    trials = numbers.read_trials(write_study(tmp_path))
    assert trials.gain.tolist() == [0.5, 0.8, 0.796, 0.7, 0.795, 0.8]
    assert trials.study.best_params == {"sigma1": 0.3, "bonus_value": 7, "normal": "cells"}


def best_values(trials: numbers.Trials) -> list[float]:
    """The curve of the best score up to each trial, as it is drawn."""
    lines = tuning.history_figure(trials).axes[0].lines
    (best,) = (line for line in lines if str(line.get_label()).startswith("Best Value"))
    return np.asarray(best.get_ydata()).tolist()


def test_the_best_value_so_far_follows_the_direction_of_the_score(tmp_path: Path) -> None:
    trials = numbers.read_trials(write_study(tmp_path))
    assert best_values(trials) == [0.5, 0.8, 0.8, 0.8, 0.8, 0.8]
    losses = made({"score": [0.9, 0.4, 0.6, 0.3], "x": [0.0, 0.1, 0.2, 0.3]}, "log_loss")
    assert best_values(losses) == [0.9, 0.4, 0.4, 0.3]


def test_the_parameter_that_decides_the_score_is_the_most_important_one() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.random((2, 300))
    score = (1 - np.abs(x - 0.3)).round(2)
    columns = {"score": score.tolist(), "y": y.tolist(), "x": x.tolist()}
    found = numbers.importances(made(columns))
    assert next(iter(found)) == "x"
    assert found["x"] > 0.8
    assert sum(found.values()) == pytest.approx(1)
    same = {"score": [0.5] * 30, "x": np.linspace(0, 1, 30).tolist()}
    assert numbers.importances(made(same)) == {}
    assert numbers.importances(made({"score": [0.1, 0.2], "x": [0.3, 0.4]})) == {}


def test_history_draws_the_numbers(tmp_path: Path) -> None:
    trials = numbers.read_trials(write_study(tmp_path))
    ax = tuning.history_figure(trials).axes[0]
    lines = {str(line.get_label()).partition(":")[0]: line for line in ax.lines}
    assert np.asarray(lines["held out"].get_ydata()).tolist() == [0.61, 0.61]


def test_few_trials_get_no_importances(tmp_path: Path) -> None:
    files = tuning.draw_study(write_study(tmp_path), style="svg")
    assert [f.name for f in files] == ["history.svg", "profile.svg"]
    assert all(f.parent == tmp_path / "figures" and f.stat().st_size > 1000 for f in files)


def test_a_study_of_one_or_two_parameters_is_drawn(tmp_path: Path) -> None:
    x, y = np.random.default_rng(0).random((2, 30)).tolist()
    one = made({"score": x, "x": x})
    two = made({"score": x, "x": x, "y": y})
    drawn: list[Callable[[], Figure]] = [
        lambda: tuning.profile_figure(one),
        lambda: tuning.importances_figure(one),
        lambda: tuning.profile_figure(two),
    ]
    for make in drawn:
        with numbers.quiet():
            assert write_figure(make, tmp_path / "a.png").stat().st_size > 1000


def test_tune_draws_what_plot_draws_again(tmp_path: Path) -> None:
    quickstart = Path(__file__).parents[2] / "experiments" / "quickstart.yaml"
    words = ["tune", quickstart, "--in-sample-only", "--trials", 30, "--jobs", 1, "--out"]
    done(*words, tmp_path / "a")
    done(*words, tmp_path / "b", "--no-figures")
    study = tmp_path / "a" / "quickstart"
    names = {f"{n}.png" for n in ("history", "profile", "importances")}
    assert {f.name for f in (study / "figures").iterdir()} == names
    assert not (tmp_path / "b" / "quickstart" / "figures").exists()
    done("plot", study, "--out", tmp_path / "c")
    for name in names:
        again = (tmp_path / "c" / name).read_bytes()
        assert again == (study / "figures" / name).read_bytes()


def test_frames_cannot_be_chosen_for_a_study(tmp_path: Path) -> None:
    assert "--frames: " in refused("plot", write_study(tmp_path), "--frames", 1, 2)


def test_a_directory_without_a_study_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not the directory of a finished study"):
        tuning.draw_study(tmp_path)
    assert not (tmp_path / "figures").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema_version": 2}, r"study\.json: is not of schema version 1; tune again"),
        ({"space": {"searched": {"p1": [0, 1]}}}, r"trials\.parquet is damaged .*p1.*; tune again"),
        ({"scores": [None] * 7}, "no trial of this study is finished"),
    ],
)
def test_what_is_no_finished_study_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        numbers.read_trials(write_study(tmp_path, **changes))
