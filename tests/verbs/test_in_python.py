"""The verbs as functions, and the objects that they return."""

from __future__ import annotations

import ast
import base64
import copy
import pydoc
import warnings
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import IPython.core.formatters
import pytest

import egolane_pgm as ego
from tests.kits.drives import contents

QUICKSTART = ego.experiments_folder() / "quickstart.yaml"


@pytest.fixture(scope="module")
def run(drive: Path) -> ego.Result:
    return ego.run(drive)


# --- what is public ------------------------------------------------------------------------------


def test_the_public_names_are_those_that_dir_and_help_show() -> None:
    assert set(dir(ego)) == {*ego.__all__, "__version__"}
    shown = pydoc.render_doc(ego, renderer=pydoc.plaintext)
    for name in set(ego.__all__) - {"cpds"}:  # a module
        assert f"class {name}(" in shown or f"\n    {name}(" in shown, name
    assert "Infer the lane in each frame" in shown


def test_editors_and_type_checkers_see_the_public_names_too() -> None:
    (block,) = (
        node
        for node in ast.parse(Path(str(ego.__file__)).read_text()).body
        if isinstance(node, ast.If)
    )
    seen = {
        name.asname: getattr(import_module(str(node.module)), name.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert seen == {name: getattr(ego, name) for name in ego.__all__}


# --- run -----------------------------------------------------------------------------------------


def test_a_representation_is_one_line_with_what_the_scores_are_worth(
    run: ego.Result, drive: Path
) -> None:
    assert repr(run) == (
        f"Result('drive': 150 frames, accuracy {run.scores['model']['accuracy']:.3f},"
        f" detector {run.scores['detector']['accuracy']:.3f}; not tuned, causal)"
    )
    tuned = ego.run(drive, overrides={"tuned_on": "same_frames", "filter": "smoothed"})
    assert repr(tuned).endswith("; in-sample, not causal)")
    blind = ego.run(drive, ground_truth="none")
    assert repr(blind) == "Result('drive': 150 frames, no ground truth; not tuned, causal)"


def test_a_notebook_draws_a_figure_though_nobody_used_pyplot(
    run: ego.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    formatter = IPython.core.formatters.DisplayFormatter()
    monkeypatch.setattr(IPython, "get_ipython", lambda: MagicMock(display_formatter=formatter))
    data, _ = formatter.format(run.plot())
    assert base64.b64decode(data["image/png"]).startswith(b"\x89PNG")
    data, _ = formatter.format(run)
    assert data == {"text/plain": repr(run)}


# --- learn and tune ------------------------------------------------------------------------------


def test_nothing_is_written_without_a_place(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    study = ego.tune(drive, trials=4, folds=2)
    assert study.directory is None
    assert study.held_out is not None
    assert repr(study).startswith("Study('drive': tune, 4 trials, accuracy ")
    assert repr(copy.copy(study)) == repr(study)
    ego.label(drive)
    assert contents(tmp_path) == {}


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verb", "given", "message"),
    [
        (ego.run, {"given": QUICKSTART, "graph": 3}, "graph: int is not a name, file"),
        (ego.run, {"given": QUICKSTART, "table": "x.csv"}, "table: needs out, the folder of its"),
        (ego.reproduce, {"runs": 11}, "run 11: the paper has runs 1 to 10"),
        (ego.reproduce, {"runs": ["one"]}, "write numbers and ranges"),
        (ego.tune, {"experiments": []}, "experiments: name at least one"),
        (ego.tune, {"experiments": QUICKSTART, "parameter": "p1=1"}, "parameter: .* needs a dict"),
        (ego.compare, {"results": []}, "results: name at least one"),
    ],
)
def test_an_argument_that_does_not_fit_is_one_line(
    verb: Any, given: dict[str, Any], message: str
) -> None:
    with warnings.catch_warnings(), pytest.raises(ego.InputError, match=message) as caught:
        verb(**given)
    assert "\n" not in str(caught.value)
