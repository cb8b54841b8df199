"""The YAML of an experiment: read, overridden, put on another recording, resolved."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from egolane_pgm.experiment import (
    Experiment,
    config_hash,
    load_experiment,
    make_experiment,
    resolved,
)
from egolane_pgm.loading import with_recording
from egolane_pgm.paper import experiments_folder
from egolane_pgm.types import InputError

MINIMAL: dict[str, Any] = {"name": "x", "recording": {"path": "a.bag"}, "n_lanes": 3}


def made(**changes: Any) -> Experiment:
    return make_experiment({**MINIMAL, **changes}, Path("/data"), "x.yaml")


def test_defaults_are_the_papers() -> None:
    experiment = made()
    assert experiment.evidence == "counting"
    assert experiment.graph == "sensor_failure"
    assert experiment.filter == "assumed_density"
    assert experiment.evidence_reading == "soft"
    assert experiment.recording.frame_rate == 10
    assert experiment.recording.missing_frames == "skip"
    assert experiment.recording.lri == "as_recorded"
    assert experiment.tuned_on == "unknown"


def test_paths_are_relative_to_the_folder_of_the_yaml(tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(yaml.safe_dump(MINIMAL))
    experiment = load_experiment(tmp_path / "e.yaml")
    assert experiment.folder == tmp_path
    assert experiment.source == str(tmp_path / "e.yaml")


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
    assert experiment.parameters == {"bonus_value": 0, "lane_widths": [1, 1, 1.2, 1]}
    assert experiment.recording.frames == (5, 9)
    assert experiment.recording.path == "a.bag"
    assert experiment.ground_truth is not None
    assert experiment.ground_truth.path == "gt.txt"
    assert experiment.description == "with = in it"


def test_an_override_below_a_plain_value_is_refused(tmp_path: Path) -> None:
    (tmp_path / "e.yaml").write_text(yaml.safe_dump(MINIMAL))
    with pytest.raises(InputError, match=r"--set name\.x=1: name has no keys below it"):
        load_experiment(tmp_path / "e.yaml", ["name.x=1"])


def test_unknown_keys_are_named_before_any_other_problem() -> None:
    with pytest.raises(InputError) as info:
        made(n_lanes=0, filtr="exact")
    assert str(info.value) == "x.yaml: unknown key 'filtr' (did you mean 'filter'?)"
    with pytest.raises(InputError) as info:
        made(qqqq=1)
    assert "(known: choice, decode, description, evidence, evidence_reading, filter," in str(
        info.value
    )


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
    bag = with_recording(old, str(tmp_path / "b.bag"), str(tmp_path / "gt2.txt"), None, "seq")
    assert bag.recording.topic == "/t"
    assert bag.recording.frame_id == "seq"
    assert bag.ground_truth is not None
    assert bag.ground_truth.path == str(tmp_path / "gt2.txt")
    assert bag.ground_truth.extra_rows == ()
    assert bag.n_lanes == 3


def test_without_ground_truth_only_the_ground_truth_goes() -> None:
    old = made(ground_truth={"path": "gt.txt"}, tuned_on="same_frames")
    new = with_recording(old, None, "none", None)
    assert new.ground_truth is None
    assert new.recording == old.recording
    assert new.name == old.name
    assert new.tuned_on == "same_frames"


def test_a_simulated_drive_cannot_be_without_its_ground_truth() -> None:
    with pytest.raises(InputError, match="--ground-truth none: a simulated drive brings its own"):
        with_recording(made(recording={"simulate": "a4"}), None, "none", None)


@given(st.text(min_size=1).filter(lambda s: "/" not in s and "\0" not in s and s.strip(".")))
def test_any_file_name_gives_a_name_for_the_experiment(stem: str) -> None:
    new = with_recording(made(), f"/data/{stem}.bag", None, None)
    assert new.name[0].isalnum()
    assert new.name.isascii()


def test_a_resolved_config_spells_everything_out_and_can_be_read_again() -> None:
    experiment = made(parameters={"sigma1": 0.3})
    content = resolved(experiment, {"sigma1": 0.3, "lane_widths": (1.0, 2.0, 1.0), "p1": 0.9})
    assert list(content["parameters"]) == ["lane_widths", "p1", "sigma1"]
    assert content["recording"]["missing_frames"] == "skip"
    assert content["ground_truth"] is None
    again = make_experiment(yaml.safe_load(yaml.safe_dump(content)), Path("/data"), "x.yaml")
    assert resolved(again, again.parameters) == content


def shuffled(value: Any, rng: random.Random) -> Any:
    if not isinstance(value, dict):
        return value
    items = [(k, shuffled(v, rng)) for k, v in value.items()]
    rng.shuffle(items)
    return dict(items)


@given(st.integers(0, 2**32))
def test_the_hash_of_a_config_does_not_depend_on_the_order_of_its_keys(seed: int) -> None:
    content = resolved(made(), {"sigma1": 0.3, "p1": 0.9, "bonus_value": 1})
    assert config_hash(shuffled(content, random.Random(seed))) == config_hash(content)


@pytest.mark.parametrize(
    ("key", "value"), [("n_lanes", 4), ("filter", "exact"), ("parameters", {"sigma1": 0.30001})]
)
def test_the_hash_of_a_config_depends_on_every_value(key: str, value: Any) -> None:
    one, other = (
        made(parameters={"sigma1": 0.3}),
        made(**{"parameters": {"sigma1": 0.3}, key: value}),
    )
    assert config_hash(resolved(one, one.parameters)) != config_hash(
        resolved(other, other.parameters)
    )


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
