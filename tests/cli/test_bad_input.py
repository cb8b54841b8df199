"""Every bad input that the project names, through the command line: one clear
line, exit code 2, and nothing is overwritten."""

from __future__ import annotations

import hashlib
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm.recordings import catalog
from egolane_pgm.recordings.catalog import DataFile
from egolane_pgm.results import read_result
from tests.kits.bags import GOOD, Line, line_bag, plain_message, truth_file, write_bag
from tests.kits.drives import command, contents, done, refused, write_drive, write_experiment


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An earlier result, which no refused command may touch."""
    folder = tmp_path_factory.mktemp("earlier")
    done("run", write_drive(folder), "--no-figures", "--out", folder / "result")
    return folder / "result"


@pytest.fixture
def earlier(result: Path) -> Iterator[Path]:
    before = contents(result.parent)
    yield result
    assert contents(result.parent) == before, "a refused command changed an earlier result"


def run_on(folder: Path, recording: Path, earlier: Path, *words: object) -> str:
    """What `egolane run` says when it refuses a recording, its result named as the earlier one."""
    experiment = write_experiment(folder / "e.yaml", recording__path=recording.name)
    return refused("run", experiment, "--no-figures", "--out", earlier, *words)


# --- refused: recordings -------------------------------------------------------------------------


def test_a_file_that_is_no_bag_is_refused(tmp_path: Path, earlier: Path) -> None:
    (tmp_path / "a.bag").write_text("frame_id,line\n1,2\n")
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert said == f"{tmp_path / 'a.bag'}: not a ROS 1 bag"


def test_a_truncated_bag_is_refused(tmp_path: Path, earlier: Path) -> None:
    whole = line_bag(tmp_path / "a.bag", [1, 2, 3]).read_bytes()
    (tmp_path / "a.bag").write_bytes(whole[: len(whole) // 2])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert f"{tmp_path / 'a.bag'}: the bag is truncated or damaged" in said
    assert "copy it again" in said


def test_an_empty_file_and_an_empty_bag_are_refused(tmp_path: Path, earlier: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"")
    assert "a.bag: the file is empty" in run_on(tmp_path, tmp_path / "a.bag", earlier)
    write_bag(tmp_path / "b.bag", [])
    assert "b.bag: the bag holds no messages" in run_on(tmp_path, tmp_path / "b.bag", earlier)


def test_a_bag_without_the_topic_is_refused_with_those_it_has(
    tmp_path: Path, earlier: Path
) -> None:
    write_bag(tmp_path / "a.bag", [plain_message(0, GOOD[0])], topic="/front/lines")
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert "no topic /isis_line_detector/lines" in said
    assert "/front/lines" in said


@pytest.mark.parametrize("offset", [float("nan"), float("inf"), float("-inf")])
def test_an_offset_that_is_no_number_is_refused_on_a_valid_line(
    tmp_path: Path, earlier: Path, offset: float
) -> None:
    bad: list[Line] = [(True, False, 9, 1.7), (True, False, 9, offset)]
    line_bag(tmp_path / "a.bag", [4, 5], [GOOD[0], bad])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert f"a.bag: frame 5: line 2 is valid but its offset is {offset}" in said
    assert "drop it or mark it not valid" in said


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", ""])
def test_the_same_in_a_table_names_the_line_of_the_file(
    tmp_path: Path, earlier: Path, text: str
) -> None:
    header = "frame_id,line,offset_m,is_valid\n"
    (tmp_path / "a.csv").write_text(f"{header}4,1,1.5,true\n5,1,{text},true\n")
    said = run_on(tmp_path, tmp_path / "a.csv", earlier)
    assert "a.csv: line 3: frame 5 has a valid line without a finite offset" in said


def test_duplicate_frame_ids_are_refused(tmp_path: Path, earlier: Path) -> None:
    line_bag(tmp_path / "a.bag", [3, 4, 4, 5])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert "a.bag: frame id 4 occurs more than once (messages 2 and 3 of the file)" in said


def test_decreasing_frame_ids_are_refused(tmp_path: Path, earlier: Path) -> None:
    line_bag(tmp_path / "a.bag", [3, 7, 5])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert "a.bag: frame ids decrease, 7 is followed by 5" in said


def test_frame_id_0_in_every_message_is_refused_and_what_is_offered_works(
    tmp_path: Path, earlier: Path
) -> None:
    line_bag(tmp_path / "a.bag", [0] * 6, GOOD)
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert "a.bag: all 6 messages have frame id 0" in said
    assert said.endswith("use --frame-id seq")
    out = tmp_path / "out"
    words = ("--ground-truth", "none", "--no-figures", "--out", out)
    done("run", tmp_path / "e.yaml", "--frame-id", "seq", *words)
    np.testing.assert_array_equal(read_result(out).frame_id, np.arange(6))
    shown = done("convert", tmp_path / "a.bag", tmp_path / "a.csv", "--frame-id", "seq").stdout
    assert "6 frames, ids 0 to 5" in shown


def test_a_recording_that_is_not_there_is_refused(tmp_path: Path, earlier: Path) -> None:
    said = run_on(tmp_path, tmp_path / "gone.bag", earlier)
    assert "e.yaml: recording.path: gone.bag: no such file" in said
    assert f"looked for {tmp_path / 'gone.bag'}" in said
    experiment = tmp_path / "e.yaml"
    said = refused("run", experiment, "--recording", tmp_path / "gone.csv", "--out", earlier)
    assert "gone.csv: no such file" in said


def test_a_range_without_a_frame_is_refused_with_the_one_there_is(
    tmp_path: Path, earlier: Path
) -> None:
    line_bag(tmp_path / "a.bag", [3, 4])
    truth_file(tmp_path / "ground_truth.txt", [(3, 1, 0)])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier, "--set", "recording.frames=[10,20]")
    assert "no frame from 10 to before 20; the recording has frames 3 to 4" in said


def test_a_frame_id_option_that_the_format_lacks_is_refused(tmp_path: Path, earlier: Path) -> None:
    (tmp_path / "a.csv").write_text("frame_id,line,offset_m\n1,1,1.5\n")
    said = run_on(tmp_path, tmp_path / "a.csv", earlier, "--frame-id", "seq")
    assert "a.csv: format table has no option 'frame_id'" in said


# --- refused: ground truth -----------------------------------------------------------------------


@pytest.mark.parametrize("lane", [0, 4, -1])
def test_ground_truth_outside_the_lanes_is_refused(
    tmp_path: Path, earlier: Path, lane: int
) -> None:
    line_bag(tmp_path / "a.bag", [1, 2, 3])
    truth_file(tmp_path / "ground_truth.txt", [(1, 1, 0), (2, lane, 0), (3, 1, 0)])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert f"ground_truth.txt: frame 2: lane {lane} is outside 1..3; is n_lanes right?" in said


def test_no_common_frames_are_refused_with_both_ranges(tmp_path: Path, earlier: Path) -> None:
    line_bag(tmp_path / "a.bag", [1, 2, 3])
    truth_file(tmp_path / "ground_truth.txt", [(100, 1, 0), (105, 1, 0)])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert "no common frames" in said
    assert "a.bag has frames 1 to 3" in said
    assert "ground_truth.txt has frames 100 to 105" in said


def test_a_file_that_is_no_ground_truth_is_refused(tmp_path: Path, earlier: Path) -> None:
    line_bag(tmp_path / "a.bag", [1, 2, 3])
    said = run_on(tmp_path, tmp_path / "a.bag", earlier, "--ground-truth", str(tmp_path / "a.bag"))
    assert "a.bag: cannot be read: is not text in UTF-8" in said


# --- refused: the experiment ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("n_lane=3", "unknown key 'n_lane' (did you mean 'n_lanes'?)"),
        ("recording.topc=x", "recording: unknown key 'topc' (did you mean 'topic'?)"),
        ("ground_truth.extra=1", "ground_truth: unknown key 'extra' (did you mean 'extra_rows'?)"),
        ("parameters.sigma_1=1", "parameters: unknown key 'sigma_1' (did you mean 'sigma1'?)"),
        ("parameters.p1=1.3", "parameters.p1: 1.3 is not a probability (0 to 1)"),
        ("parameters.p4=-0.1", "parameters.p4: -0.1 is not a probability (0 to 1)"),
        ("parameters.p2=.nan", "parameters.p2: nan is not a finite number"),
        ("parameters.sigma1=0", "parameters.sigma1: 0 must be greater than 0"),
        ("parameters.sigma2=-1", "parameters.sigma2: -1 must be greater than 0"),
        ("parameters.sigma1=[1,2]", "parameters.sigma1: needs one number, got a list"),
        ("parameters.lane_widths=[1,2]", "parameters.lane_widths: has 2 values for 3 lanes"),
        ("parameters.bonus_value=two", "parameters.bonus_value: 'two' is not a number"),
        ("parameters.normal=densty", "'densty' is not one of density, integral (did you mean"),
        ("n_lanes=0", "n_lanes: input should be greater than or equal to 1 (got 0)"),
        ("n_lanes=true", "n_lanes: input should be a valid integer (got True)"),
        ("n_lanes=null", "n_lanes: input should be a valid integer"),
        ("name=../x", "name: string should match pattern"),
        (
            "filter=exat",
            "filter: 'exat' is not one of assumed_density, exact, smoothed, fixed_lag (did",
        ),
        ("evidence_reading=softer", "evidence_reading: 'softer' is not one of soft, hard"),
        ("recording.missing_frames=keep", "missing_frames: 'keep' is not one of skip, hold"),
        ("recording.lri=cut", "recording.lri: 'cut' is not one of as_recorded, clip"),
        ("recording.frame_rate=0", "recording.frame_rate: input should be greater than 0 (got 0)"),
        ("recording.frame_rate=.inf", "recording.frame_rate: input should be a finite number"),
        ("recording.frames=[9,3]", "recording: frames [9, 3] is an empty range"),
        ("recording.simulate=a4", "recording: needs either path or simulate"),
        ("recording.path=null", "recording: needs either path or simulate"),
        ("recording.format=rosbg", "unknown format 'rosbg' (did you mean 'rosbag'?)"),
        ("graph=sensor_failur", "graph: unknown name 'sensor_failur' (did you mean"),
        ("evidence=counted", "evidence: unknown name 'counted' (did you mean 'counting'?)"),
        ("graph=./no.py", "graph: no file"),
        ("tuned_on=mars", "tuned_on: 'mars' is not one of same_frames"),
    ],
)
def test_a_key_or_value_that_does_not_fit_is_refused_by_validate_and_by_run(
    tmp_path: Path, earlier: Path, override: str, said: str
) -> None:
    experiment = write_drive(tmp_path, 20)
    by_run = refused("run", experiment, "--set", override, "--no-figures", "--out", earlier)
    assert said in by_run
    if not override.startswith("recording.format"):
        assert by_run.startswith(f"{experiment}: ")
    by_validate = refused("validate", experiment, "--set", override)
    assert said in by_validate
    assert by_validate.startswith(f"{experiment}: ")
    # The same written in the file.
    content = yaml.safe_load(experiment.read_text())
    *above, last = override.partition("=")[0].split(".")
    section = content
    for key in above:
        section = section.setdefault(key, {})
    section[last] = yaml.safe_load(override.partition("=")[2])
    experiment.write_text(yaml.safe_dump(content))
    assert refused("validate", experiment) == by_validate


def test_validate_knows_simulated_drives(tmp_path: Path) -> None:
    experiment = write_experiment(tmp_path / "e.yaml", recording={"simulate": "quikstart"})
    said = refused("validate", experiment)
    assert "recording.simulate: unknown preset 'quikstart' (did you mean 'quickstart'?)" in said


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: b: c\n", "is not YAML"),
        ("- 1\n", "needs keys and values"),
        ("", "needs keys and values"),
        ("recording: {simulate: a4}\nn_lanes: 3\n", "name: is missing"),
        ("name: a\nrecording: 5\nn_lanes: 3\n", "recording: input should be"),
    ],
)
def test_a_file_that_is_no_experiment_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "e.yaml").write_text(text)
    assert refused("validate", tmp_path / "e.yaml").startswith(f"{tmp_path / 'e.yaml'}: {said}")


def test_an_experiment_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    assert "gone.yaml: cannot be read: No such file" in refused("run", tmp_path / "gone.yaml")
    assert "is a directory" in refused("run", tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    assert "binary.yaml: cannot be read" in refused("run", tmp_path / "binary.yaml")


@pytest.mark.parametrize("override", ["n_lanes", "=3", "a..b=1", "parameters.p1=[", "n_lanes.x=1"])
def test_an_override_that_is_none_is_refused(tmp_path: Path, override: str) -> None:
    experiment = write_drive(tmp_path, 20)
    assert refused("validate", experiment, "--set", override).startswith(f"--set {override}: ")


@pytest.mark.parametrize("n_lanes", ["0", "-2", "x"])
def test_a_number_of_lanes_that_is_none_is_refused(
    tmp_path: Path, earlier: Path, n_lanes: str
) -> None:
    experiment = write_drive(tmp_path, 20)
    said = refused("run", experiment, "--n-lanes", n_lanes, "--no-figures", "--out", earlier)
    assert "lanes" in said


def test_a_command_line_that_makes_no_sense_is_one_line(tmp_path: Path) -> None:
    assert "No such command 'rn'" in refused("rn")
    assert "egolane run --help" in refused("run", "x.yaml", "--frame-id", "stamp")
    assert "Missing argument" in refused("run")
    assert "--seed" in refused("recover", "--run", "7", "--seed", "-1")


# --- refused: where the result goes --------------------------------------------------------------


@pytest.mark.parametrize("what", ["--out", "--json"])
def test_a_place_that_cannot_be_written_is_refused_before_anything_is_computed(
    tmp_path: Path, earlier: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_drive(tmp_path, 20)
    before = contents(tmp_path)
    monkeypatch.setattr(
        "egolane_pgm.cli.run.run_experiment", lambda *a, **k: pytest.fail("computed")
    )
    below_a_file = experiment / "below" / "result"
    words = ("run", experiment, "--no-figures")
    if what == "--json":
        words = (*words, "--out", earlier)
    said = refused(*words, what, below_a_file)
    assert f"{below_a_file}: cannot be written, {experiment} is not a writable directory" in said
    said = refused(*words, what, "/proc/egolane/result")  # not even root may
    assert said.startswith("/proc/egolane/result: cannot be written")
    assert contents(tmp_path) == before


def test_a_directory_of_somebody_elses_is_not_overwritten(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, 20)
    before = contents(tmp_path)
    said = refused("run", experiment, "--no-figures", "--out", tmp_path)
    assert said.startswith(f"{tmp_path}: exists and is not a result directory")
    said = refused("run", experiment, "--no-figures", "--out", experiment)
    assert "is a file" in said
    assert contents(tmp_path) == before


def test_other_commands_name_what_they_cannot_write(tmp_path: Path) -> None:
    write_drive(tmp_path, 20)
    lines = tmp_path / "lines.csv"
    assert "cannot be written" in refused("convert", lines, tmp_path / "no" / "a.csv")
    assert "unknown extension '.txt'" in refused("convert", lines, tmp_path / "a.txt")
    assert "cannot be created" in refused("simulate", "--out", lines / "below")
    (tmp_path / "taken" / "experiment.yaml").mkdir(parents=True)
    assert "cannot be written" in refused("simulate", "--out", tmp_path / "taken")


def test_what_cannot_be_simulated_is_refused(tmp_path: Path) -> None:
    out = ("--out", tmp_path / "x")
    assert "did you mean 'quickstart'" in refused("simulate", "quikstart", *out)
    assert "simulation.n_lanes: 0" in refused("simulate", *out, "--n-lanes", "0")
    assert "simulation.n_frames: 0" in refused("simulate", *out, "--frames", "0")
    assert "did you mean 'clutter'" in refused("simulate", *out, "--set", "cluter=1")
    assert "write it as key=value" in refused("simulate", *out, "--set", "noise_m")
    assert "not YAML" in refused("simulate", *out, "--set", "noise_m=[1")
    assert not (tmp_path / "x").exists()


# --- refused: a mirror ---------------------------------------------------------------------------


@pytest.fixture
def mirror(tmp_path: Path) -> Iterator[str]:
    (tmp_path / "mirror").mkdir()
    (tmp_path / "mirror" / "one.bag").write_bytes(b"not what it should be")

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, directory=str(tmp_path / "mirror"), **kwargs)

        def log_message(self, *args: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_mirror_that_sends_a_wrong_checksum_is_refused_and_a_good_file_kept(
    tmp_path: Path, mirror: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = b"the right content, 26 byte"
    files = tuple(
        DataFile(name, len(good), hashlib.sha256(good).hexdigest(), "x")
        for name in ("one.bag", "two.bag")
    )
    monkeypatch.setattr(catalog, "_FILES", files)
    folder = tmp_path / "data"
    (folder / "rle").mkdir(parents=True)
    (folder / "rle" / "two.bag").write_bytes(good)
    result = command("data", "fetch", "--base-url", mirror, "--folder", folder)
    assert result.exit_code == 2
    assert result.stderr.startswith(f"egolane: one.bag: {mirror}/one.bag sends something else")
    assert "wrong checksum" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert "1 of 2 files are there and good" in result.stdout
    assert contents(folder) == {"rle/two.bag": good}


def test_no_file_is_counted_as_good_where_there_is_no_network(tmp_path: Path) -> None:
    result = command("data", "fetch", "--base-url", "http://127.0.0.1:9", "--folder", tmp_path)
    assert result.exit_code == 2
    assert result.stdout == "0 of 12 files are there and good\n"
    assert len(result.stderr.splitlines()) == 1
    assert "no connection to 127.0.0.1:9 (" in result.stderr


def test_an_address_that_is_none_is_refused(tmp_path: Path) -> None:
    said = refused("data", "fetch", "--base-url", "ftp://x", "--folder", tmp_path)
    assert "--base-url ftp://x" in said
