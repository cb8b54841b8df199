"""Learning from the drives of a fleet together, and what is held out of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import egolane_pgm as ego
from egolane_pgm.comparing.placing import parts_of_fleet
from egolane_pgm.drive import Drive, beliefs_of, load_drive
from egolane_pgm.experiment import Experiment
from egolane_pgm.fleet import FleetDrive, drives_of
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.expected_counts import FREE
from egolane_pgm.learning import fit, fit_pooled, with_found
from egolane_pgm.learning.em import Training, fit_tables, fit_tables_pooled
from egolane_pgm.learning.fleet import learn_fleet
from egolane_pgm.learning.held_out import scores_of
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import Evidence, InputError, IntArray
from tests.conformance.networks import draw_evidence, draw_graph
from tests.conftest import needs_compiler
from tests.kits.drives import done, refused, short_drive, simulated, write_drive

pytestmark = pytest.mark.filterwarnings("ignore:.*no frame to learn from has lane:UserWarning")


def some_recordings(seed: int) -> tuple[Compiled, list[Training]]:
    """A random network, and what is seen of it in three recordings, some of it known."""
    rng = np.random.default_rng(seed)
    drawn = draw_graph(rng)
    compiled = drawn.compiled()
    node = str(rng.choice(drawn.hidden))
    found = []
    for n in (12, 1, 25):
        value = rng.integers(compiled.cardinality[node], size=n)
        known = {node: np.where(rng.random(n) < 0.7, FREE, value)}
        evidence = draw_evidence(compiled, n, rng, zeros=0.1)
        found.append(Training(evidence, known, rng.random(n) < 0.1))
    return compiled, found


def behind_each_other(seen: list[Training]) -> Training:
    begins = [np.concatenate([[True], each.is_first[1:]]) for each in seen]  # type: ignore[index]
    (node,) = seen[0].known
    return Training(
        Evidence.joined([each.evidence for each in seen]),
        {node: np.concatenate([each.known[node] for each in seen])},
        np.concatenate(begins),
    )


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8, deadline=None)
def test_pooled_is_one_behind_the_other_in_any_order(seed: int) -> None:
    compiled, seen = some_recordings(seed)
    one = behind_each_other(seen)
    whole = fit_tables(compiled, one.evidence, one.known, one.is_first, iterations=5)
    for order in (seen, seen[::-1]):
        pooled = fit_tables_pooled(compiled, order, iterations=5)
        np.testing.assert_allclose(pooled.log_posterior, whole.log_posterior, rtol=1e-12)
        for node, table in whole.tables.items():
            np.testing.assert_allclose(pooled.tables[node].values, table.values, atol=1e-12)
    pooled = fit_tables_pooled(compiled, seen, iterations=5)
    np.testing.assert_array_equal(pooled.is_impossible, whole.is_impossible)


def drive(seed: int, n_frames: int = 300, **keys: object) -> Experiment:
    recording = {"simulate": "quickstart", "seed": seed, "frames": [0, n_frames]}
    return simulated(f"d{seed}", recording=recording, **keys)


def loaded(experiment: Experiment) -> tuple[Drive, IntArray]:
    read = load_drive(experiment, needs_truth=None)
    return read, np.arange(len(read))


def mirrored(seen: Drive) -> Drive:
    log, truth = seen.recorded.log, seen.truth
    lane = seen.n_lanes + 1 - truth.lane
    other = replace(
        seen.recorded, log=replace(log, offset_m=-log.offset_m), truth=replace(truth, lane=lane)
    )
    return replace(seen, recorded=other)


@needs_compiler
def test_mirrored_drives_teach_mirrored_tables() -> None:
    drives, trains = zip(*(loaded(drive(seed)) for seed in (1, 2)), strict=True)
    found = fit_pooled(drives, trains)
    other = fit_pooled([mirrored(each) for each in drives], trains)
    assert len(found) > 2
    for name in ("tables.Lane.first", "tables.Lane.next"):
        np.testing.assert_allclose(other[name], found[name][::-1], atol=1e-9)  # type: ignore[index]
    seen = np.reshape(found["tables.DetectorOutput"], (2, 4, 4))
    after = np.reshape(other["tables.DetectorOutput"], (2, 4, 4))
    np.testing.assert_allclose(after, seen[:, ::-1, ::-1], atol=1e-9)


@needs_compiler
def test_one_drive_is_learned_from_as_without_a_fleet(tmp_path: Path) -> None:
    write_drive(tmp_path, 600)
    table = tmp_path / "drives.csv"
    table.write_text("recording,ground_truth\nlines.csv,ground_truth.txt\n")
    base = tmp_path / "experiment.yaml"
    alone, fleet = ego.learn(base, blocks=3), ego.learn(base, fleet=table, blocks=3)
    assert fleet.learned.parameters == alone.learned.parameters
    assert fleet.learned.scores == (alone.scores["model"],)
    assert fleet.learned.log_evidence == alone.learned.log_evidence
    assert "held out: 3 blocks of the one drive" in fleet.title


@needs_compiler
def test_a_drive_is_scored_with_what_the_others_teach() -> None:
    experiments = [drive(seed) for seed in (1, 2, 3)]
    learned = learn_fleet(experiments, [(0, 2), (1,)])
    drives, trains = zip(*map(loaded, experiments), strict=True)
    assert learned.parameters == fit_pooled(drives, trains)
    without = fit(drives[1], trains[1])
    assert without != learned.parameters
    for k in (0, 2):
        beliefs, _ = beliefs_of(drives[k], with_found(drives[k].model, without, experiments[k]))
        assert learned.scores[k] == scores_of(drives[k], beliefs, trains[k])


def table(folder: Path, *rows: str, head: str = "name,recording.seed,tag.weather") -> Path:
    path = folder / "drives.csv"
    path.write_text("\n".join([head, *rows]))
    return path


def base(folder: Path, **keys: object) -> Path:
    recording = {"simulate": "quickstart", "frames": [0, 200]}
    content = {"name": "base", "recording": recording, "n_lanes": 4, "tuned_on": "not_tuned"}
    path = folder / "base.yaml"
    path.write_text(yaml.safe_dump({**content, "learning": {"labels": False}, **keys}))
    return path


@needs_compiler
def test_what_a_fleet_taught_is_written_and_says_how_it_was_held_out(tmp_path: Path) -> None:
    drives = table(tmp_path, "a,1,sun", "b,2,rain", "c,3,sun")
    out, target = tmp_path / "l.yaml", tmp_path / "l.json"
    words = ("learn", base(tmp_path), "--fleet", drives, "--out", out)
    said = done(*words, "--by-tag", "weather", "--json", target).stdout
    assert "learned from 3 drives of drives.csv" in said
    assert "held out: 2 parts of the drives, by tag.weather" in said.replace("\n", " ")
    assert "log evidence per frame" in said
    found = json.loads(target.read_text())
    assert [row["part"] for row in found["drives"]] == [1, 2, 1]
    assert np.shape(found["parameters"]["tables.Lane.next"]) == (4, 4)
    assert "from 3 drives of drives.csv" in out.read_text()
    done("run", out, "--no-figures", "--out", tmp_path / "result")
    learned = ego.learn(base(tmp_path), fleet=drives, by_tag="weather", jobs=2)
    assert list(learned.rows) == found["drives"]
    assert "weather rain" in learned._repr_html_()


@needs_compiler
def test_frames_that_are_chosen_are_those_of_the_drives(tmp_path: Path) -> None:
    for name in "ab":
        write_table(tmp_path / f"{name}.csv", short_drive().log)
    frames = "[0, 60]"
    said = []
    for rows, words in (
        (("a,a.csv,", "b,b.csv,"), ("--set", f"recording.frames={frames}")),
        ((f'a,a.csv,"{frames}"', f'b,b.csv,"{frames}"'), ()),
        (("a,a.csv,", "b,b.csv,"), ()),
    ):
        drives = table(tmp_path, *rows, head="name,recording,recording.frames")
        target = tmp_path / "l.json"
        options = ("--set", "n_lanes=3", "--fleet", drives, "--out", tmp_path / "l.yaml")
        done("learn", base(tmp_path), *options, "--json", target, *words)
        said.append(json.loads(target.read_text())["drives"][0]["log_evidence.held_out"])
    assert said[0] == said[1] != said[2]


def placed(tags: str, keys: str) -> tuple[list[FleetDrive], list[str]]:
    """Drives with a tag each; those with the same letter are of one drive."""
    drives = [
        FleetDrive(f"f.csv: drive {k}", f"d{k}", {}, {"a": tag} if tag != "-" else {}, Path())
        for k, tag in enumerate(tags, 1)
    ]
    return drives, drives_of(drives, [drive(ord(key)) for key in keys])


@pytest.mark.parametrize(
    ("tags", "keys", "tag", "n_parts", "parts"),
    [
        ("xxxxx", "abcde", None, 2, ((0, 1, 2), (3, 4))),
        ("xxxxx", "abaca", None, 5, ((0, 2, 4), (1,), (3,))),
        ("xyxyx", "abaca", "a", 5, ((0, 2, 4), (1, 3))),
        ("x", "a", None, 5, ()),
    ],
)
def test_rows_of_one_drive_are_held_out_together(
    tags: str, keys: str, tag: str | None, n_parts: int, parts: tuple[tuple[int, ...], ...]
) -> None:
    assert parts_of_fleet(*placed(tags, keys), n_parts, tag) == parts


@pytest.mark.parametrize(
    ("tags", "keys", "tag", "message"),
    [
        ("xx", "aa", None, "drive 1: all other rows are of this drive"),
        ("xx", "ab", "a", "drive 1: all other rows have this tag.a"),
        ("x-", "ab", "a", "drive 2: has no tag.a"),
        ("xx", "ab", "b", "drive 1: has no tag.b"),
        ("xyx", "aab", "a", "drive 1: d1, d2 are one drive, of which tag.a differs"),
    ],
)
def test_a_fleet_of_which_nothing_can_be_held_out_is_refused(
    tags: str, keys: str, tag: str | None, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        parts_of_fleet(*placed(tags, keys), 5, tag)


def test_what_does_not_fit_a_fleet_is_refused_in_one_line(tmp_path: Path) -> None:
    drives = table(tmp_path, "a,1,sun", "b,2,rain")
    words = ("learn", base(tmp_path), "--fleet", drives)
    assert "--by-tag: goes with a fleet" in refused(*words[:2], "--jobs", 2)
    assert f"{drives}: is read here" in refused(*words, "--json", drives)
    other = table(tmp_path, "a,1,3", "b,2,4", head="name,recording.seed,n_lanes")
    assert "b: n_lanes is not that of a" in refused("learn", base(tmp_path), "--fleet", other)
    head = "name,recording.seed,recording,n_lanes"
    absent = table(tmp_path, "a,1,,4", "b,,none.csv,4", head=head)
    said = refused("learn", base(tmp_path), "--fleet", absent)
    assert said.startswith("b: ")
    assert "none.csv" in said
    labels = base(tmp_path, learning={"labels": True})
    write_table(tmp_path / "lines.csv", short_drive().log)
    bare = table(tmp_path, "a,1,,4", "b,,lines.csv,4", head=head)
    said = refused("learn", labels, "--fleet", bare)
    assert said.startswith("b: ")
    assert "ground_truth: is missing, learning needs it" in said
