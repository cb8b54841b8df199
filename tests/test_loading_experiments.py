"""The YAML of an experiment: read, overridden, put on another recording, resolved."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from egolane_pgm.drive import with_recording
from egolane_pgm.experiment import (
    Experiment,
    experiments_folder,
    load_experiment,
    make_experiment,
    resolved,
)
from egolane_pgm.model import prepare_model
from egolane_pgm.tuning.plan import load_plan
from egolane_pgm.types import InputError
from tests.kits.drives import refused

MINIMAL: dict[str, Any] = {"name": "x", "recording": {"path": "a.bag"}, "n_lanes": 3}


def made(**changes: Any) -> Experiment:
    return make_experiment({**MINIMAL, **changes}, Path("/data"), "x.yaml")


def test_an_experiment_that_comes_with_the_package_is_found_from_every_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_experiment("experiments/quickstart.yaml").name == "quickstart"
    assert load_plan("experiments/tuning/all_spain.yaml").name == "all_spain"
    with pytest.raises(InputError, match=r"^experiments/none\.yaml: cannot be read"):
        load_experiment("experiments/none.yaml")
    own = tmp_path / "experiments" / "quickstart.yaml"
    own.parent.mkdir()
    own.write_text("{name: mine, recording: {simulate: quickstart}, n_lanes: 4}")
    assert load_experiment("experiments/quickstart.yaml").name == "mine"
    assert load_experiment(own).folder == own.parent


def test_overrides_reach_every_level_and_are_read_as_yaml(tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(yaml.safe_dump(MINIMAL))
    experiment = load_experiment(
        tmp_path / "e.yaml",
        [
            "n_lanes=4",
            "parameters.bonus_value=0",
            "parameters.lane_widths=[1, 1, 1.2, 1]",
            "recording.frames=[5, 9]",
            "ground_truth.path=gt.txt",
            "description=with = in it",
            "n_lanes=5",
        ],
    )
    assert experiment.n_lanes == 5
    assert experiment.parameters == {"bonus_value": 0, "lane_widths": (1, 1, 1.2, 1)}
    assert experiment.recording.frames == (5, 9)
    assert experiment.recording.path == "a.bag"
    assert experiment.ground_truth is not None
    assert experiment.ground_truth.path == "gt.txt"
    assert experiment.description == "with = in it"


# --- what is wrong -------------------------------------------------------------------------------


def wrong_in(**changes: Any) -> str:
    """What is said of the minimal experiment with these changes."""
    with pytest.raises(InputError) as info:
        made(**changes)
    assert str(info.value).startswith("x.yaml: ")
    return str(info.value).removeprefix("x.yaml: ")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"recording": {"path": "a.bag", "frame_rate": -1, "frame": [0, 9]}, "n_lanes": 3.5},
            "recording: unknown key 'frame' (did you mean 'frames'?)",
        ),
        (
            {"recording": {"path": "a.bag", "frame_rate": -1}},
            "recording.frame_rate: input should be greater than 0 (got -1)",
        ),
        (
            {"recording": {"path": "a.bag", "missing_frames": "hol"}},
            "recording.missing_frames: 'hol' is not one of skip, hold, predict (did you mean"
            " 'hold'?)",
        ),
        (
            {"filter": "fixed_lag"},
            "lag: filter fixed_lag needs a number of frames to wait, e.g. lag: 10 (got None)",
        ),
        (
            {"tuning": {"blocks": 1}},
            "tuning.blocks: input should be greater than or equal to 2 (got 1)",
        ),
        ({"parameters": [0.3]}, "parameters: needs keys and values (got [0.3])"),
    ],
)
def test_the_first_key_that_does_not_fit_is_named(changes: dict[str, Any], said: str) -> None:
    assert wrong_in(**changes) == said


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"sigma1": -1, "sigm2": 0.3}, "parameters: unknown key 'sigm2' (did you mean 'sigma2'?)"),
        ({"bonus_value": "much"}, "parameters.bonus_value: 'much' is not a number"),
        ({"sigma1": -1}, "parameters.sigma1: -1 must be greater than 0"),
        ({"p1": 2}, "parameters.p1: 2 is not a probability (0 to 1)"),
        ({"lane_widths": [1, 2]}, "parameters.lane_widths: has 2 values for 3 lanes"),
    ],
)
def test_the_first_parameter_that_does_not_fit_is_named(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as info:
        prepare_model(made(parameters=wrong))
    assert str(info.value) == f"x.yaml: {said}"


@pytest.mark.parametrize(
    ("tuning", "said"),
    [
        (
            {"objective": "acuracy"},
            "tuning.objective: unknown score 'acuracy' (did you mean 'accuracy'?)",
        ),
        (
            {"parameters": {"sigm1": 3}},
            "tuning.parameters: unknown parameter 'sigm1' (did you mean 'sigma1'?)",
        ),
    ],
)
def test_the_settings_of_a_search_are_checked(
    tmp_path: Path, tuning: dict[str, Any], said: str
) -> None:
    drive = {"n_lanes": 3, "recording": {"simulate": "quickstart"}}
    path = write(tmp_path / "one.yaml", name="one", tuning=tuning, **drive)
    assert refused("run", "--dry-run", path) == f"{path}: {said}"


def test_an_unknown_key_is_named_before_the_missing_one_that_it_means() -> None:
    with pytest.raises(InputError) as info:
        make_experiment({"nam": "x", "recordin": {}}, Path(), "x.yaml")
    assert str(info.value) == "x.yaml: unknown key 'nam' (did you mean 'name'?)"


# --- made in Python ------------------------------------------------------------------------------


def test_overrides_are_a_dict_as_well(tmp_path: Path) -> None:
    path = write(tmp_path / "e.yaml", **MINIMAL, parameters={"sigma1": 0.2, "p1": 0.9})
    found = load_experiment(
        path,
        {
            "parameters": {"sigma1": np.float32(0.5), "lane_widths": np.array([1, 2, 1])},
            "parameters.p2": np.float64(0.8),
            "recording": {"frames": (5, np.int64(9)), "path": Path("b") / "c.bag"},
            "n_lanes": np.int64(4),
            "ground_truth": None,
            "tuning.parameters": {"p1": [0.5, 0.9]},
        },
    )
    assert found.parameters == {"sigma1": 0.5, "p1": 0.9, "lane_widths": (1, 2, 1), "p2": 0.8}
    assert type(found.parameters["p2"]) is float
    assert found.recording.frames == (5, 9)
    assert found.recording.path == str(Path("b/c.bag"))
    assert found.n_lanes == 4
    assert found.tuning is not None
    assert found.tuning.parameters == {"p1": (0.5, 0.9)}
    words = ["parameters.sigma1=0.5", "n_lanes=4"]
    same = load_experiment(path, {"parameters": {"sigma1": 0.5}, "n_lanes": 4})
    assert same == load_experiment(path, words)


def test_none_takes_a_key_or_a_section_away(tmp_path: Path) -> None:
    path = write(tmp_path / "e.yaml", **MINIMAL, parameters={"sigma1": 0.2, "p1": 0.9})
    assert load_experiment(path, {"parameters.p1": None}).parameters == {"sigma1": 0.2}
    for empty in (None, {}):
        other = load_experiment(path, {"graph": "lane_only", "parameters": empty})
        assert other.parameters == {}
    with pytest.raises(InputError, match="unknown key 'filtr'"):
        load_experiment(path, {"filtr": None})


def test_overrides_that_do_not_fit_are_named(tmp_path: Path) -> None:
    path = write(tmp_path / "e.yaml", **MINIMAL)
    wrong = {"filtr": "exact", "recording.lry": "clip", "n_lanes": "four"}
    with pytest.raises(InputError) as info:
        load_experiment(path, wrong)
    assert str(info.value) == f"{path}: recording: unknown key 'lry' (did you mean 'lri'?)"
    for wrong in ({1: 2}, {"": 1}, {"a..b": 1}, {"parameters": {2: 0.3}}):
        with pytest.raises(InputError, match="is not the name of a key"):
            load_experiment(path, wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="name: input should be a valid string"):
        load_experiment(path, {"name.x": 1})
    with pytest.raises(InputError, match=r"overrides: name\.x=1: name has no keys below it"):
        load_experiment(path, ["name.x=1"])
    for neither in ("n_lanes=4", [("n_lanes", 4)], 4):
        with pytest.raises(InputError, match="needs a dict, or a list of key=value"):
            load_experiment(path, neither)  # type: ignore[arg-type]
    assert load_experiment(path, None) == load_experiment(path, {}) == load_experiment(path)


def test_an_experiment_can_be_made_without_a_file(tmp_path: Path) -> None:
    content = {"name": "x", "recording": {"simulate": "a4"}, "n_lanes": 3, "version": 1}
    found = load_experiment(content, {"recording.seed": 3})
    path = write(tmp_path / "x.yaml", **content)
    assert resolved(found, {}) == resolved(load_experiment(path, ["recording.seed=3"]), {})
    assert found.folder == Path()
    assert content["recording"] == {"simulate": "a4"}
    with pytest.raises(InputError, match=r"^experiment: unknown key 'lanes'"):
        load_experiment({**content, "lanes": 3})
    with pytest.raises(InputError, match=r"^experiment: include: no file nothing\.yaml$"):
        load_experiment({**content, "include": "nothing.yaml"})
    with pytest.raises(InputError, match=r"^experiment: version: 3 is not 1"):
        load_experiment({**content, "version": 3})


def rich() -> Experiment:
    """An experiment with something nested in every key that may have it."""
    return made(
        recording={"path": "a", "options": {"x": [1, {"y": [2]}]}, "detector_parameters": {"a": 1}},
        parameters={"lane_widths": [1, 2, 1], "table": {"rows": [[1, 2], [3, 4]]}},
        tuning={"parameters": {"p1": [0.5, 0.9]}},
        learning={"tables": ["Lane"]},
    )


def test_nothing_in_an_experiment_can_be_changed() -> None:
    copied = rich().model_copy(update={"parameters": {"table": {"rows": [[1]]}}})
    for experiment in (rich(), copied, rich().model_copy(deep=True)):
        for part in (experiment, experiment.recording):
            with pytest.raises(ValidationError, match="frozen"):
                part.name = "other"  # type: ignore[union-attr]
        table: Any = experiment.parameters["table"]
        assert isinstance(table["rows"][0], tuple)
        for change in (table.clear, table.popitem, lambda t=table: t.update(a=1)):
            with pytest.raises(TypeError, match="an experiment stays as it is"):
                change()


def test_experiments_are_equal_hashed_copied_and_pickled_by_what_they_say() -> None:
    one, same, other = rich(), rich(), rich().model_copy(update={"parameters": {}})
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert len({one, same, other}) == 2
    for again in (pickle.loads(pickle.dumps(one)), copy.deepcopy(one), copy.copy(one)):
        assert again == one
        assert again.folder == one.folder
        with pytest.raises(TypeError):
            again.parameters["a"] = 1
    # What is dumped is the user's to change.
    content = one.model_dump()
    content["parameters"]["table"]["rows"] = 3
    assert one == same
    assert make_experiment(one.model_dump(), one.folder, one.source) == one


def test_a_recording_of_ones_own_takes_nothing_from_the_old_one(tmp_path: Path) -> None:
    old = made(
        recording={
            "path": "a.bag",
            "frames": [1, 9],
            "topic": "/t",
            "lri": "clip",
            "frame_rate": 5,
        },
        ground_truth={"path": "gt.txt", "extra_rows": [[0, 1, 0]]},
        tuned_on="same_frames",
        parameters={"sigma1": 0.3},
    )
    new = with_recording(old, str(tmp_path / "my drive.csv"), None, 2)
    assert new.name == "my_drive"
    assert new.recording.path == str(tmp_path / "my drive.csv")
    assert new.recording.frames is None
    assert new.recording.topic is None  # a table has none
    assert new.recording.lri == "clip"
    assert new.recording.frame_rate == 5
    assert new.ground_truth is None
    assert new.n_lanes == 2
    assert new.parameters == {"sigma1": 0.3}
    assert new.tuned_on == "other_frames"
    bag = with_recording(old, str(tmp_path / "b.bag"), str(tmp_path / "gt2.txt"), None)
    assert bag.recording.topic == "/t"
    assert bag.ground_truth is not None
    assert bag.ground_truth.path == str(tmp_path / "gt2.txt")
    assert bag.ground_truth.extra_rows == ()
    assert bag.n_lanes == 3


def test_the_recording_that_an_experiment_was_tuned_on_stays_in_sample(tmp_path: Path) -> None:
    own, copy = tmp_path / "a.csv", tmp_path / "b.csv"
    for path in (own, copy):
        path.write_text("frame_id,line,offset_m\n1,1,0.5\n")
    (tmp_path / "link.csv").symlink_to(own)
    for path, said in (
        (own, "same_frames"),
        (tmp_path / "link.csv", "same_frames"),
        (copy, "other_frames"),
    ):
        old = made(recording={"path": str(own), "frames": [0, 9]}, tuned_on="same_frames")
        assert with_recording(old, str(path), None, None).tuned_on == said
    old = made(recording={"path": str(own)}, tuned_on="other_frames")
    assert with_recording(old, str(own), None, None).tuned_on == "other_frames"


def test_what_is_overridden_is_meant_for_the_recording_that_is_named(tmp_path: Path) -> None:
    overrides = ["recording.frames=[3, 7]", "n_lanes=4", "name=mine"]
    old = load_experiment(made(tuned_on="same_frames"), overrides)
    new = with_recording(old, str(tmp_path / "b.csv"), None, None, overrides=overrides)
    assert new.recording.frames == (3, 7)
    assert new.recording.path == str(tmp_path / "b.csv")
    assert (new.name, new.n_lanes, new.tuned_on) == ("mine", 4, "other_frames")
    options = with_recording(old, str(tmp_path / "b.csv"), None, 2, overrides=overrides)
    assert options.n_lanes == 2
    for other in ({"recording.path": "c.csv"}, {"recording.simulate": "a4"}):
        with pytest.raises(InputError, match="two of them; leave one out"):
            with_recording(old, str(tmp_path / "b.csv"), None, None, overrides=other)


def test_a_simulated_drive_cannot_be_without_its_ground_truth() -> None:
    with pytest.raises(InputError, match="ground_truth: none: a simulated drive brings its own"):
        with_recording(made(recording={"simulate": "a4"}), None, "none", None)


def test_the_lanes_of_a_simulated_drive_are_not_taken_for_those_of_another_road() -> None:
    old = made(recording={"simulate": "a4"}, ground_truth=None)
    with pytest.raises(InputError, match=r"^n_lanes: is missing: .* 3 of .*x\.yaml is its simulat"):
        with_recording(old, "lines.csv", None, None, overrides={"filter": "exact"})
    for overrides in ({"n_lanes": 3}, ["n_lanes=3"]):
        assert with_recording(old, "lines.csv", None, None, overrides=overrides).n_lanes == 3


def test_a_resolved_config_spells_everything_out_and_can_be_read_again() -> None:
    experiment = made(parameters={"sigma1": 0.3})
    content = resolved(experiment, {"sigma1": 0.3, "lane_widths": (1.0, 2.0, 1.0), "p1": 0.9})
    assert list(content["parameters"]) == ["lane_widths", "p1", "sigma1"]
    assert content["recording"]["missing_frames"] == "skip"
    assert content["ground_truth"] is None
    again = make_experiment(yaml.safe_load(yaml.safe_dump(content)), Path("/data"), "x.yaml")
    assert resolved(again, again.parameters) == content


def test_every_experiment_that_comes_along_is_described_and_has_its_own_name() -> None:
    # Those of the tuning folder say what to search: `tune` has tests of their own for them.
    paths = [
        p
        for p in experiments_folder().rglob("*.yaml")
        if p.name != "published.yaml" and p.parent.name != "tuning" and p.name[0] != "_"
    ]
    experiments = [load_experiment(p) for p in paths]
    assert len(experiments) >= 11
    assert all(e.description for e in experiments)
    assert len({e.name for e in experiments}) == len(experiments)


# --- include and version -------------------------------------------------------------------------


def write(path: Path, **content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def test_keys_that_a_file_lacks_come_from_the_one_it_includes(tmp_path: Path) -> None:
    write(tmp_path / "far" / "_base.yaml", n_lanes=3, recording={"simulate": "a4", "seed": 4})
    write(tmp_path / "_near.yaml", include="far/_base.yaml", n_lanes=4, parameters={"p1": 0.9})
    recording = {"seed": 7, "frames": [0, 100]}
    given = {"name": "one", "recording": recording, "parameters": {"p2": 0.8}}
    path = write(tmp_path / "one.yaml", include="_near.yaml", **given)
    found = load_experiment(path, ["recording.frames=[0, 50]"])
    assert found.n_lanes == 4
    assert found.parameters == {"p1": 0.9, "p2": 0.8}
    whole = {"simulate": "a4", "seed": 7, "frames": [0, 50]}
    alone = write(tmp_path / "alone.yaml", **given | {"recording": whole, "n_lanes": 4})
    same = load_experiment(alone, ["parameters={p1: 0.9, p2: 0.8}"])
    assert resolved(found, found.parameters) == resolved(same, same.parameters)
    assert found.folder == tmp_path
    assert "include" not in resolved(found, {})


def test_an_include_that_leads_nowhere_is_one_line(tmp_path: Path) -> None:
    def said(path: Path) -> str:
        with pytest.raises(InputError) as caught:
            load_experiment(path)
        assert "\n" not in str(caught.value)
        return str(caught.value)

    a, b = tmp_path / "a.yaml", tmp_path / "b.yaml"
    write(a, include="b.yaml")
    assert said(a) == f"{a}: include: no file {b}"
    write(b, include="a.yaml")
    assert said(a) == f"{b}: include: a.yaml includes this file itself"
    write(a, include="a.yaml")
    assert said(a) == f"{a}: include: a.yaml includes this file itself"
    write(a, include=["b.yaml"])
    assert said(a) == f"{a}: include: ['b.yaml'] is not the name of a file"
    write(a, include="b.yaml", name="x")
    write(b, n_lane=3, recording={"simulate": "a4"})
    assert said(a) == f"{a}: unknown key 'n_lane' (did you mean 'n_lanes'?)"


def test_a_file_may_say_its_version_and_a_future_one_is_refused(tmp_path: Path) -> None:
    given = {"name": "x", "n_lanes": 3, "recording": {"simulate": "a4"}}
    plain = load_experiment(write(tmp_path / "x.yaml", **given))
    versioned = load_experiment(write(tmp_path / "y.yaml", version=1, **given))
    assert plain.model_dump() == versioned.model_dump()
    for version in (2, "1", True, None):
        path = write(tmp_path / "z.yaml", version=version, **given)
        with pytest.raises(InputError) as caught:
            load_experiment(path)
        assert str(caught.value) == f"{path}: version: {version!r} is not 1, the one known here"


def test_every_file_that_comes_along_says_its_version() -> None:
    paths = list(experiments_folder().rglob("*.yaml"))
    assert len(paths) > 20
    for path in paths:
        assert yaml.safe_load(path.read_text())["version"] == 1, path
