from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.experiment import load_experiment
from egolane_pgm.fleet import drive_experiment, pooled, read_fleet
from egolane_pgm.scoring.bootstrap import RESAMPLES, over_drives
from egolane_pgm.scoring.confusion import accuracy
from egolane_pgm.types import InputError
from tests.kits.drives import command, done, refused, write_drive

QUICKSTART = ego.experiments_folder() / "quickstart.yaml"


def table(folder: Path, text: str, name: str = "drives.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def fleet_of(folder: Path, n: int = 4) -> Path:
    rows = [f'd{k},{k},"[0, 150]",{"rain" if k % 2 else "sun"}' for k in range(n)]
    head = "name,recording.seed,recording.frames,tag.weather"
    return table(folder, "\n".join([head, *rows]))


def were_there(fleet: Path, out: Path, overrides: Mapping[str, Any] = MappingProxyType({})) -> int:
    """Run the drives; how many of them were not run again."""
    found = ego.run(QUICKSTART, fleet=fleet, out=out, overrides=overrides).to_text()
    said = re.search(r"(\d+)\s+of\s+them\s+were\s+there", found)
    return int(said[1]) if said else 0


def without_times(folder: Path) -> pd.DataFrame:
    return pd.read_parquet(folder / "summary.parquet").drop(columns=["seconds", "result"])


def test_a_fleet_is_the_same_as_csv_parquet_and_yaml(tmp_path: Path) -> None:
    as_csv = table(tmp_path, "recording,n_lanes,tag.road\na.csv,3,A4\nb.csv,,A2\n")
    as_yaml = table(
        tmp_path,
        "drives:\n- {recording: a.csv, n_lanes: 3, tag.road: A4}\n"
        "- {recording: b.csv, tag.road: A2}\n",
        "drives.yaml",
    )
    as_parquet = tmp_path / "drives.parquet"
    rows = {"recording": ["a.csv", "b.csv"], "n_lanes": [3, None], "tag.road": ["A4", "A2"]}
    pd.DataFrame(rows).astype({"n_lanes": "Int64"}).to_parquet(as_parquet)
    read = [
        [(d.name, dict(d.cells), dict(d.tags)) for d in read_fleet(path)]
        for path in (as_csv, as_yaml, as_parquet)
    ]
    assert read[0] == [
        ("a", {"recording": "a.csv", "n_lanes": 3}, {"road": "A4"}),
        ("b", {"recording": "b.csv"}, {"road": "A2"}),
    ]
    assert read[1] == read[0]
    assert read[2] == read[0]


def test_a_row_changes_the_keys_that_it_names(tmp_path: Path) -> None:
    path = table(tmp_path, "recording.seed,n_lanes,parameters.sigma1\n7,3,0.2\n8,,\n")
    base = load_experiment(QUICKSTART)
    first, second = (drive_experiment(base, drive) for drive in read_fleet(path))
    assert (first.name, first.recording.seed, first.n_lanes) == ("drive_1", 7, 3)
    assert first.parameters["sigma1"] == 0.2
    assert (second.name, second.recording.seed, second.n_lanes) == ("drive_2", 8, base.n_lanes)
    assert second.parameters == base.parameters


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("recording,n_lane\na.csv,3\n", "unknown column 'n_lane' (did you mean 'n_lanes'?)"),
        ("recording,weather\na.csv,rain\n", "is a tag: tag.weather"),
        ("recording\n", "has no drives"),
        ("", "has no drives"),
        ("recording,n_lanes\na.csv\n", "line 2: has 1 cells, the first line has 2"),
        ("recording\nx/a.csv\nx/a.csv\n", "drive 2: has the name 'x_a', as drive 1"),
        ("recording,n_lanes\na.csv,[\n", "line 2: n_lanes: is not YAML"),
        ("recording,\na.csv,3\n", "column '' has no name"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(InputError) as refused:
        read_fleet(table(tmp_path, text))
    assert message in str(refused.value)
    assert str(tmp_path / "drives.csv") in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", "x", "a fleet is a .csv, .parquet or .yaml file"),
        ("a.yaml", "drive: []", "unknown key 'drive'"),
        ("a.yaml", "drives: 3", "drives: needs a list"),
        ("a.parquet", "nothing", "is not a whole Parquet file"),
    ],
)
def test_other_files_are_refused_in_one_line(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read_fleet(table(tmp_path, content, name))
    with pytest.raises(InputError, match="cannot be read"):
        read_fleet(tmp_path / "absent.csv")


def test_processes_write_the_same_summary_as_one(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path)
    ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "one")
    ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "two", jobs=2)
    pd.testing.assert_frame_equal(
        without_times(tmp_path / "one"), without_times(tmp_path / "two"), check_exact=True
    )


def test_drives_that_are_there_are_not_run_again(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path)
    assert were_there(fleet, tmp_path / "out") == 0
    before = without_times(tmp_path / "out")
    assert were_there(fleet, tmp_path / "out") == 4
    pd.testing.assert_frame_equal(before, without_times(tmp_path / "out"), check_exact=True)
    fleet.write_text(fleet.read_text().replace("d3,3,", "d3,33,"))
    assert were_there(fleet, tmp_path / "out") == 3
    assert were_there(fleet, tmp_path / "out", {"parameters.sigma1": 0.3}) == 0


def test_a_recording_that_changed_is_run_again(tmp_path: Path) -> None:
    write_drive(tmp_path / "drive")
    lines = tmp_path / "drive" / "lines.csv"
    fleet = table(tmp_path, "recording,n_lanes\ndrive/lines.csv,3\n")
    ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "out")
    assert were_there(fleet, tmp_path / "out") == 1
    kept = lines.read_text().splitlines()
    lines.write_text("\n".join(kept[:-40]) + "\n")
    assert were_there(fleet, tmp_path / "out") == 0


def test_what_is_overridden_is_meant_for_the_drives(tmp_path: Path) -> None:
    write_drive(tmp_path / "drive")
    fleet = table(tmp_path, "name,recording,recording.frames\na,drive/lines.csv,\n")
    base = {"recording.frames": [0, 90], "n_lanes": 3}
    found = ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "out", overrides=base)
    assert found.to_pandas().loc["a", "frames"] == 90
    fleet = table(tmp_path, 'name,recording,recording.frames\na,drive/lines.csv,"[0, 60]"\n')
    found = ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "out", overrides=base)
    assert found.to_pandas().loc["a", "frames"] == 60


def test_a_drive_that_fails_does_not_stop_the_others(tmp_path: Path) -> None:
    head = "name,recording,recording.seed,recording.frames,n_lanes"
    fleet = table(
        tmp_path, f'{head}\ngood,,1,"[0, 150]",\nabsent,nowhere.csv,,,4\nodd,,1,,nine hundred\n'
    )
    out = command("run", QUICKSTART, "--fleet", fleet, "--out", tmp_path / "out")
    assert out.exit_code == 1
    assert "failed: absent:" in out.stderr
    assert "nowhere.csv" in out.stderr
    assert "drive 3" in out.stderr
    summary = pd.read_parquet(tmp_path / "out" / "summary.parquet").set_index("name")
    assert summary["error"].isna().to_list() == [True, False, False]
    assert summary.loc["good", "frames"] == 150


def test_a_fleet_goes_with_one_experiment(tmp_path: Path) -> None:
    fleet = fleet_of(tmp_path)
    for extra in ([QUICKSTART], ["--recording", "a.csv"], ["--n-lanes", "3"]):
        said = refused("run", QUICKSTART, *extra, "--fleet", fleet)
        assert said.startswith("--fleet: goes with one experiment")
    assert "--fleet: goes with" in refused("compare", "--fleet", fleet)


def test_compare_pairs_the_drives_of_a_fleet(tmp_path: Path) -> None:
    text = fleet_of(tmp_path).read_text().replace("[0, 150]", "[0, 300]")
    fleet = table(tmp_path, text)
    other = tmp_path / "exact.yaml"
    other.write_text(f"include: {QUICKSTART}\nname: exact\nfilter: exact\n")
    out = done("compare", QUICKSTART, other, "--fleet", fleet, "--wide")
    rows = [line.split("|") for line in out.stdout.splitlines() if line.startswith("|")][2:]
    said = [[cell.strip() for cell in row[1:4]] for row in rows]
    assert said == [
        [f"{who}", name, n]
        for who, n in (("all", "4"), ("weather rain", "2"), ("weather sun", "2"))
        for name in ("quickstart", "exact")
    ]


def test_the_share_over_drives_is_that_of_all_frames() -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(50, 500, 30).astype(float)
    right = np.round(frames * rng.uniform(0.5, 1.0, 30))
    sums = np.stack([right, frames], axis=1)
    share, interval = over_drives(sums)
    assert share == right.sum() / frames.sum()
    assert interval is not None
    low, high = interval
    assert low < share < high
    # The spread of a ratio, by the delta method.
    spread = np.sqrt(30 * np.var(right - share * frames)) / frames.sum()
    assert high - low == pytest.approx(2 * 1.96 * spread, rel=3 / np.sqrt(RESAMPLES) + 0.1)
    assert over_drives(sums[:1]) == (right[0] / frames[0], None)
    assert over_drives(sums) == over_drives(sums)


def test_rows_of_one_drive_are_drawn_together() -> None:
    rng = np.random.default_rng(2)
    one = rng.integers(0, 100, (12, 4, 3))
    other = one + rng.integers(0, 9, one.shape)
    names = [f"d{k}" for k in range(12)]
    for minus in (None, other):
        twice = None if minus is None else np.concatenate([minus, minus])
        rows = np.concatenate([one, one])
        alone = over_drives(one, accuracy, minus)
        assert over_drives(one, accuracy, minus, drive_of=names) == alone
        assert over_drives(rows, accuracy, twice, drive_of=names * 2) == alone
        # As drives of their own they would tell more than they do.
        assert np.ptp(over_drives(rows, accuracy, twice)[1]) < 0.8 * np.ptp(alone[1])  # type: ignore[arg-type]
    assert over_drives(one[:2], accuracy, drive_of=["a", "a"])[1] is None


def test_a_second_detector_on_each_drive_makes_no_interval_narrower(tmp_path: Path) -> None:
    rows = [f"{k},{k},'[0, 150]'" for k in range(3)]
    head = "name,recording.seed,recording.frames"
    fleet = table(tmp_path, "\n".join([head, *rows]).replace("'", '"'))
    alone = ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "one")
    assert [row["drive"] for row in alone.rows] == ["0", "1", "2"]
    again = [f"b{row}" for row in rows]
    fleet = table(tmp_path, "\n".join([head, *rows, *again]).replace("'", '"'))
    for _ in range(2):
        both = ego.run(QUICKSTART, fleet=fleet, out=tmp_path / "both")
        assert [row["drive"] for row in both.rows] == ["0", "1", "2"] * 2
        assert pooled(both.rows)[0].interval == pytest.approx(pooled(alone.rows)[0].interval)
    assert were_there(fleet, tmp_path / "both") == 6


def test_a_difference_over_drives_is_paired() -> None:
    rng = np.random.default_rng(1)
    one = rng.integers(0, 100, (12, 4, 3))
    other = one.copy()
    other[:, 0, 0] += 5
    assert over_drives(one, accuracy, one) == (0.0, (0.0, 0.0))
    difference, interval = over_drives(other, accuracy, one)
    assert difference == accuracy(other.sum(axis=0)) - accuracy(one.sum(axis=0))
    assert interval is not None
    # Unpaired, twelve drives that differ as much as these overlap zero.
    assert 0 < interval[0] < difference < interval[1]
