"""Experiments: read from YAML, overridden, put on other lines, resolved."""

from __future__ import annotations

import copy
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from egolane_pgm.drives import check_sources
from egolane_pgm.experiment import Experiment, make_experiment, resolved
from egolane_pgm.loading import IN_MEMORY, experiments_folder, load_experiment
from egolane_pgm.types import InputError
from tests.kits.drives import write_drive

MINIMAL: dict[str, Any] = {"name": "x", "recording": {"path": "a.bag"}, "n_lanes": 3}


def write(path: Path, **content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def made(**changes: Any) -> Experiment:
    return make_experiment({**MINIMAL, **changes}, "x.yaml")


# --- paths ---------------------------------------------------------------------------------------


def test_a_shipped_experiment_is_found_from_every_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for given in ("quickstart", "experiments/quickstart.yaml"):
        assert load_experiment(given).name == "quickstart"
    own = write(tmp_path / "experiments" / "quickstart.yaml", **{**MINIMAL, "name": "mine"})
    assert load_experiment("experiments/quickstart.yaml").name == "mine"
    assert load_experiment(own).recording.path == str(own.parent / "a.bag")


def test_every_path_is_absolute_after_loading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, data = tmp_path / "here", tmp_path / "data"
    here.mkdir()
    data.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("EGOLANE_DATA", str(data))
    (data / "far.txt").touch()
    path = write(
        tmp_path / "there" / "e.yaml",
        **MINIMAL,
        graph="./mine.py",
        evidence="counting",
        ground_truth={"path": "far.txt"},
    )
    found = load_experiment(path, {"recording.camera": "cam.yaml"})
    assert found.graph == str(tmp_path / "there" / "mine.py")
    assert found.evidence == "counting"
    # What lies in the data folder, and what an override names.
    assert found.ground_truth is not None
    assert found.ground_truth.path == str(data / "far.txt")
    assert found.recording.camera == str(here / "cam.yaml")
    # Paths in an included file are those of the including one.
    including = write(tmp_path / "near" / "f.yaml", include="../there/e.yaml")
    assert load_experiment(including).recording.path == str(tmp_path / "near" / "a.bag")
    monkeypatch.chdir(tmp_path)
    assert load_experiment(found).recording == found.recording


# --- overrides -----------------------------------------------------------------------------------


def test_overrides_reach_every_level_and_are_read_as_yaml(tmp_path: Path) -> None:
    path = write(tmp_path / "e.yaml", **MINIMAL)
    words = [
        "n_lanes=4",
        "parameters.bonus_value=0",
        "parameters.p3=[0.6, 0.6, 0.7, 0.6]",
        "recording.frames=[5, 9]",
        "description=with = in it",
        "n_lanes=5",
    ]
    found = load_experiment(path, words)
    assert found.n_lanes == 5
    assert found.parameters == {"bonus_value": 0, "p3": (0.6, 0.6, 0.7, 0.6)}
    assert found.recording.frames == (5, 9)
    assert found.description == "with = in it"
    same = {
        "n_lanes": np.int64(5),
        "parameters": {"bonus_value": np.float64(0), "p3": np.array([0.6, 0.6, 0.7, 0.6])},
        "recording.frames": (5, np.int64(9)),
        "description": "with = in it",
    }
    assert load_experiment(path, same) == found
    assert load_experiment(path, None) == load_experiment(path, {}) == load_experiment(path)


def test_overrides_are_checked_together_with_what_they_need(tmp_path: Path) -> None:
    path = write(tmp_path / "e.yaml", **MINIMAL)
    late = load_experiment(path, ["lag=3", "filter=fixed_lag"])
    assert (late.filter, late.lag) == ("fixed_lag", 3)
    back = load_experiment(late, {"filter": "exact", "lag": None})
    assert (back.filter, back.lag) == ("exact", None)


def test_the_model_of_an_experiment_is_put_on_other_lines(tmp_path: Path) -> None:
    lines = str(tmp_path / "my drive.csv")
    found = load_experiment("zero_label", lines=lines, n_lanes=4, overrides=["start_lane=4"])
    assert (found.name, found.n_lanes, found.start_lane) == ("my_drive", 4, 4)
    assert found.recording.path == lines
    old = made(
        recording={"path": "/d/a.bag", "frames": [1, 9], "topic": "/t", "frame_rate": 5},
        ground_truth={"path": "/d/gt.txt"},
        tuned_on="same_frames",
        parameters={"sigma1": 0.3},
    )
    new = load_experiment(old, {"recording.format": "table"}, lines=lines)
    # Nothing of the old recording is left.
    assert new.recording.model_dump(exclude_unset=True) == {"path": lines, "format": "table"}
    assert (new.ground_truth, new.tuned_on) == (None, "unknown")
    assert (new.parameters, new.n_lanes) == ({"sigma1": 0.3}, 3)
    assert load_experiment(old, lines="/d/a.bag").tuned_on == "same_frames"
    in_memory = load_experiment("zero_label", lines=object(), n_lanes=2)
    assert (in_memory.recording.path, in_memory.name) == (IN_MEMORY, "in_memory")


def test_keys_that_a_file_lacks_come_from_the_one_it_includes(tmp_path: Path) -> None:
    write(tmp_path / "far" / "_base.yaml", n_lanes=3, recording={"simulate": "a4", "seed": 4})
    write(tmp_path / "_near.yaml", include="far/_base.yaml", n_lanes=4, parameters={"p1": 0.9})
    recording = {"seed": 7, "frames": [0, 100]}
    given = {"name": "one", "recording": recording, "parameters": {"p2": 0.8}}
    path = write(tmp_path / "one.yaml", include="_near.yaml", **given)
    whole = {"simulate": "a4", "seed": 7, "frames": [0, 100]}
    both = {"p1": 0.9, "p2": 0.8}
    alone = {"name": "one", "recording": whole, "n_lanes": 4, "parameters": both, "version": 1}
    found, same = load_experiment(path), load_experiment(alone)
    assert resolved(found, found.parameters) == resolved(same, same.parameters)


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"recording.topik": "x", "n_lanes": 3.5}, "recording: unknown key 'topik' (did you mean"),
        (
            {"recording.missing_frames": "hol"},
            "recording.missing_frames: input should be 'skip', 'hold' or 'predict' (got 'hol')",
        ),
        ({"recording.path": None}, "recording: needs either path or simulate"),
        ({"name": None}, "name: is missing"),
        ({"filtr": None}, "unknown key 'filtr' (did you mean 'filter'?)"),
        ({"filter": "fixed_lag"}, "lag: filter fixed_lag needs a number of frames to wait, e.g."),
        ({"lag": 3}, "lag: only filter fixed_lag waits, filter assumed_density has no lag (got 3)"),
        ({"filter": "viterbi", "min_confidence": 0.5}, "filter viterbi gives every frame a lane"),
        ({"start_lane": 5}, "start_lane: the road has lanes 1 (leftmost) to 3 (got 5)"),
        ({"start_lane": [0, 0, 0]}, "start_lane: the lanes' probabilities are not negative, and"),
        ({"parameters": [0.3]}, "parameters: needs keys and values"),
        ({"recording.frame_rate": True}, "recording.frame_rate: takes neither true nor false"),
        ({"n_lanes": 51}, "n_lanes: input should be less than or equal to 50"),
        ({"n_lanes": "map"}, "n_lanes: map needs a road table"),
        ({"road": "road.parquet"}, "n_lanes: a road table gives the number of lanes"),
        (
            {"n_lanes": "map", "road": "r.parquet", "start_lane": 1},
            "start_lane: does not go with n_lanes: map",
        ),
        ({1: 2}, "1 is not the name of a key"),
        ({"a..b": 1}, "'a..b' is not the name of a key"),
        (["n_lanes"], "overrides: n_lanes: write it as key=value"),
        ("n_lanes=4", "overrides: 'n_lanes=4': needs a dict, or a list of key=value"),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line_that_names_it(
    tmp_path: Path, changes: Any, said: str
) -> None:
    path = write(tmp_path / "e.yaml", **MINIMAL)
    with pytest.raises(InputError) as info:
        load_experiment(path, changes)
    assert said in str(info.value)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"nam": "x", "recordin": {}}, "e.yaml: unknown key 'nam' (did you mean 'name'?)"),
        ({**MINIMAL, "version": 3}, "e.yaml: version: 3 is not 1, the one known here"),
        ({"include": "e.yaml"}, "e.yaml: include: 'e.yaml' is not the name of another file"),
        ({"include": "loop.yaml"}, "loop.yaml: include: 'e.yaml' is not the name of another file"),
        ({"include": ["b.yaml"]}, "e.yaml: include: ['b.yaml'] is not the name of another file"),
        ("quikstart", "quikstart: no such file, nor experiment (see `egolane show`) (did you mean"),
        ("experiments/none.yaml", "experiments/none.yaml: cannot be read"),
        (3, "3 is no experiment; give the path of a YAML file"),
    ],
)
def test_what_is_no_experiment_is_refused(tmp_path: Path, given: Any, said: str) -> None:
    given = write(tmp_path / "e.yaml", **given) if isinstance(given, dict) else given
    write(tmp_path / "loop.yaml", include="e.yaml")
    with pytest.raises(InputError, match=re.escape(said)):
        load_experiment(given)
    with pytest.raises(InputError, match=r"^experiment: unknown key 'lanes'"):
        load_experiment({**MINIMAL, "lanes": 3})


def test_sources_are_checked_without_reading_them(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    (tmp_path / "lines.csv").write_text("no table")
    check_sources(load_experiment(path))
    (tmp_path / "ground_truth.txt").unlink()
    with pytest.raises(InputError, match=r"ground_truth\.path: .*ground_truth\.txt: no such file"):
        check_sources(load_experiment(path))


# --- what an experiment is -----------------------------------------------------------------------


def rich() -> Experiment:
    """An experiment with a nested value in every key that may have one."""
    return made(
        recording={"path": "a", "detector": "ml", "options": {"x": [1, {"y": [2]}]}},
        parameters={
            "detector": {"a": 1},
            "p3": [0.6, 0.7, 0.6],
            "table": {"rows": [[1, 2], [3, 4]]},
        },
        fit={"parameters": {"p1": [0.5, 0.9]}},
    )


def test_an_experiment_cannot_be_changed_and_is_compared_by_content() -> None:
    one, same, other = rich(), rich(), rich().model_copy(update={"parameters": {}})
    with pytest.raises(ValidationError, match="frozen"):
        one.recording.path = "other"  # type: ignore[misc]
    assert one == same
    assert len({one, same, other}) == 2
    for again in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one), copy.copy(one)):
        assert (again, again.source) == (one, one.source)
    # A dump can be changed.
    content = one.model_dump()
    content["parameters"]["table"]["rows"] = 3
    assert one == same


def test_a_resolved_config_has_every_key_and_can_be_read_again() -> None:
    experiment = made(recording={"path": "/a.bag"}, parameters={"sigma1": 0.3})
    content = resolved(experiment, {"sigma1": 0.3, "p3": (0.6, 0.7, 0.6), "p1": 0.9})
    assert list(content["parameters"]) == ["p1", "p3", "sigma1"]
    assert content["recording"]["missing_frames"] == "skip"
    again = load_experiment(yaml.safe_load(yaml.safe_dump(content)))
    assert resolved(again, again.parameters) == content


def test_every_shipped_experiment_is_described_and_has_its_own_name_and_version() -> None:
    paths = list(experiments_folder().rglob("*.yaml"))
    assert len(paths) > 20
    for path in paths:
        assert yaml.safe_load(path.read_text())["version"] == 1, path
    experiments = [
        load_experiment(path)
        for path in paths
        if path.name != "published.yaml" and path.parent.name != "tuning" and path.name[0] != "_"
    ]
    assert all(each.description for each in experiments)
    assert len({each.name for each in experiments}) == len(experiments) >= 11
