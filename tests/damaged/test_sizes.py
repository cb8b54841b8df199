"""Small files that ask for much: refused at once, in a line that says what they would need."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

import egolane_pgm as ego
from egolane_pgm import types
from egolane_pgm.api.studies import TuneResult
from egolane_pgm.camera.pictures import read_image
from egolane_pgm.cli.show import compile_defaults
from egolane_pgm.maps.positions import read_positions
from egolane_pgm.maps.road_table import load as load_road
from egolane_pgm.plugins import load_plugin
from egolane_pgm.recordings import read_lines
from egolane_pgm.report.study_trials import TRIALS_FILE
from egolane_pgm.scoring.bootstrap import circular_block_bootstrap
from egolane_pgm.tools import files
from egolane_pgm.types import InputError


def refusal(read: Callable[[], object]) -> str:
    """What is said of it, in one line and within two seconds of a processor."""
    begun = time.thread_time()
    with pytest.raises(InputError) as caught:
        read()
    assert time.thread_time() - begun < 2
    [line] = caught.value.lines
    return line


def picture(kind: str, width: int, height: int) -> bytes:
    """A picture whose header says that it is so large."""
    content = bytearray(cv2.imencode(f".{kind}", np.zeros((16, 16, 3), np.uint8))[1].tobytes())
    if kind == "jpg":
        at = content.index(b"\xff\xc0") + 5
        content[at : at + 4] = struct.pack(">HH", height, width)
    elif kind == "bmp":
        content[18:26] = struct.pack("<ii", width, height)
    else:
        at = content.index(b"16 16")
        content[at : at + 5] = f"{width} {height}".encode()
    return bytes(content)


@pytest.mark.parametrize("kind", ["jpg", "bmp", "ppm"])
@pytest.mark.parametrize("size", [12_000, 32_000])
def test_a_picture_that_says_it_is_huge(kind: str, size: int, tmp_path: Path) -> None:
    file = tmp_path / f"a.{kind}"
    file.write_bytes(picture(kind, size, size))
    assert file.stat().st_size < 1000
    said = refusal(lambda: read_image(file))
    assert said.startswith(f"{file}: cannot be read: Image size ({size**2} pixels) exceeds limit")


def graph(path: Path, nodes: str, tables: str) -> Path:
    path.write_text(
        f"nodes: {{Lane: n_lanes, {nodes}}}\nhidden: [Lane]\nobserved: [X]\n"
        "edges: {within: [Lane -> X, A -> X, B -> X, C -> X]}\n"
        f"tables: {{Lane: uniform, {tables}}}\n"
    )
    return path


@pytest.mark.parametrize(
    ("nodes", "tables", "said"),
    [
        ("X: 922337203685477580", "X: uniform", "nodes.X: a table from 922337203685477580 to as"),
        (
            "A: 999, B: 999, C: 999, X: 2",
            "A: uniform, B: uniform, C: uniform, X: {stack: {over: A, else: uniform}}",
            "tables.X: a table of 4 x 999 x 999 x 999 x 2 numbers would need 59.4 GB of memory",
        ),
    ],
)
def test_a_graph_of_more_values_than_there_is_memory(
    nodes: str, tables: str, said: str, tmp_path: Path
) -> None:
    path = graph(tmp_path / "x.yaml", nodes, tables)

    def compiled() -> None:
        compile_defaults("x.yaml", load_plugin("graphs", "x.yaml", tmp_path, "x.yaml"), 4)

    found = refusal(compiled)
    assert said in found
    assert "GB of memory, more than the 2 GB that are taken" in found
    assert path.name in found


@pytest.mark.parametrize("graph_name", ["position_in_lane", "position_in_changing_lanes"])
def test_a_thousand_cells_in_a_lane(graph_name: str) -> None:
    experiment = {
        "name": "x",
        "n_lanes": 4,
        "recording": {"simulate": "quickstart"},
        "evidence": "line_geometry",
        "graph": graph_name,
        "parameters": {"cells": 1000},
    }
    if graph_name == "position_in_changing_lanes":
        experiment["recording"] = {"simulate": "interchange"}
    said = refusal(lambda: ego.run(experiment))
    assert "parameters: cells 1000, motion_bins 49: the table of RoadPosition would need 1" in said


@pytest.mark.parametrize("key", ["wor_levels", "failure_phases", "motion_bins"])
def test_a_number_of_values_that_is_no_number_of_values(key: str) -> None:
    of = {"wor_levels": ("counting_levels", "wor_levels")}
    of |= {"failure_phases": ("counting", "failure_duration")}
    evidence, graph_name = of.get(key, ("line_geometry", "position_in_lane"))
    experiment = {
        "name": "x",
        "n_lanes": 4,
        "recording": {"simulate": "quickstart"},
        "evidence": evidence,
        "graph": graph_name,
        "parameters": {key: 10**9},
    }
    said = refusal(lambda: ego.run(experiment))
    assert f"parameters.{key}: 1000000000 must be at most " in said


def test_a_table_of_lines_with_one_line_of_1000(tmp_path: Path) -> None:
    path = tmp_path / "lines.csv"
    rows = "".join(f"{k},1,0.5\n" for k in range(100_000))
    path.write_text(f"frame_id,line,offset_m\n{rows}100000,1000,0.5\n")
    said = refusal(lambda: read_lines(path))
    assert said == (
        f"{path}: 100001 frames of 1000 lines each (the most that one has) would need 3.4 GB of"
        " memory, more than the 2 GB that are taken"
    )


def trials_of(path: Path) -> object:
    study: dict[str, Any] = {"name": path.name}
    return TuneResult((study,), {path.name: {TRIALS_FILE: path.read_bytes()}}).to_pandas()


@pytest.mark.parametrize("read", [read_lines, read_positions, load_road, trials_of])
def test_a_parquet_file_with_more_rows_than_there_is_memory(
    read: Callable[[Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(types, "MOST_BYTES", 1 << 20)
    path = tmp_path / "a.parquet"
    # Equal cells take no place: how many they are, and the cell.
    names = ("frame_id", "line", "offset_m", "t_s", "latitude", "longitude")
    parquet.write_table(pa.table(dict.fromkeys(names, np.ones(100_000))), path)
    assert path.stat().st_size < 20_000
    said = refusal(lambda: read(path))
    said = said.replace(f"{path.name}/{TRIALS_FILE}", str(path))
    assert said.startswith(f"{path}: 100000 rows of 6 columns would need 0.0 GB of memory, more")


@pytest.mark.parametrize("frames", [[0, 10**12], [10**12, 10**13]])
def test_a_simulated_drive_is_as_long_as_its_preset(frames: list[int]) -> None:
    keys = {"recording.frames": frames}
    if frames[0] == 0:
        assert len(ego.run("experiments/quickstart.yaml", overrides=keys)) == 1200
    else:
        said = refusal(lambda: ego.run("experiments/quickstart.yaml", overrides=keys))
        assert "no frame from 1000000000000 to before 10000000000000" in said


def test_a_device_that_never_ends_is_no_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "MOST_TEXT", 1 << 20)
    (tmp_path / "tune.yaml").write_text("name: x\nexperiments: [/dev/zero]\n")
    said = refusal(lambda: ego.tune(tmp_path / "tune.yaml"))
    assert said.endswith(
        "tune.yaml: experiments: /dev/zero: has more than 1 MB, no text of ours has"
    )


def test_counts_beyond_what_a_machine_does() -> None:
    said = refusal(lambda: circular_block_bootstrap(3000, resamples=10**12))
    assert said == (
        "resamples: 1000000000000 of 10 blocks each would need 74,505.8 GB of memory, more than the"
        " 2 GB that are taken"
    )
    keys = {"tuning.trials": 10**18, "learning.iterations": 10**18, "learning.strength": 1e100}
    for key, value in keys.items():
        said = refusal(partial(ego.load_experiment, "experiments/quickstart.yaml", {key: value}))
        assert f"{key}: input should be less than or equal to 1" in said
