"""Odd names, places and ends of the commands, as a user may meet them: one line each, nothing lost,
no file that is read written over."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from egolane_pgm.compare import comparing
from egolane_pgm.experiment import load_experiment
from egolane_pgm.results import check_place, is_result, staged
from egolane_pgm.run import run_experiment, save_run
from egolane_pgm.types import InputError
from tests.kits.drives import command, contents, done, refused, write_drive
from tests.kits.synthetic_road import write_place

MAIN = [sys.executable, "-c", "from egolane_pgm.cli.main import main; main()"]

needs_links = pytest.mark.skipif(sys.platform == "win32", reason="needs links and signals")

#: An evidence rule that tells when it begins, and takes its time.
SLOW = """
    import time
    from pathlib import Path
    from egolane_pgm.evidence import counting
    from egolane_pgm.evidence.counting import *
    def evidence(log, *given, **named):
        Path(log.source).with_suffix(".begun").touch()
        if "fast" not in log.source:
            time.sleep(60)
        return counting.evidence(log, *given, **named)
"""


def started(*words: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*MAIN, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for(*files: Path) -> None:
    for _ in range(600):
        if all(file.exists() for file in files):
            return
        time.sleep(0.1)
    raise AssertionError(f"{files} did not come")


# --- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["with space", "mit Ümläut", "new\nline", "-dash", "a;b&c'd\"e"])
def test_any_name_of_a_folder_will_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    path = write_drive(tmp_path / name)
    out = tmp_path / "out" / name
    said = done("run", path, "--no-figures", "--out", out, "--json", tmp_path / f"{name}.json")
    assert f"result: {out}" in said.stdout
    assert is_result(out)
    kept = run_experiment(out / "experiment.yaml")
    assert kept.scores["model"]["accuracy"] == pytest.approx(
        json.loads((tmp_path / f"{name}.json").read_text())["model"]["accuracy"]
    )


@needs_links
def test_a_name_that_is_not_text_is_refused_by_every_reader_and_writer(tmp_path: Path) -> None:
    """OpenCV dies of such a name, and with it what was computed."""
    path = write_drive(tmp_path)
    write_place(tmp_path, 3)
    odd = os.fsdecode(b"a\xff")
    (tmp_path / f"{odd}.csv").write_bytes((tmp_path / "lines.csv").read_bytes())
    (tmp_path / f"{odd}.avi").write_bytes((tmp_path / "drive.avi").read_bytes())
    camera = ["--camera", tmp_path / "cam.yaml"]
    drive, lanes = tmp_path / "drive.avi", ["--n-lanes", 2]
    for words in (
        ("run", path, "--recording", tmp_path / f"{odd}.csv"),
        ("run", path, "--out", tmp_path / odd),
        ("lines", tmp_path / f"{odd}.csv", "--frame", 1),
        ("detect", tmp_path / f"{odd}.avi", *camera, "-o", tmp_path / "l.csv"),
        ("detect", drive, *camera, "-o", tmp_path / f"{odd}.parquet"),
        ("video", tmp_path / f"{odd}.avi", *camera, *lanes, "-o", tmp_path / "o.mp4"),
        ("video", drive, *camera, *lanes, "-o", tmp_path / f"{odd}.mp4"),
        ("video", drive, *camera, *lanes, "-o", tmp_path / odd),
        ("simulate", "--out", tmp_path / odd),
        ("simulate", "--images", "--frames", 1, "--out", tmp_path / odd),
    ):
        assert "the name is not text in UTF-8; rename it" in refused(*words)


def test_empty_names_are_not_taken_for_the_folder_one_is_in(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    write_place(tmp_path, 3)
    before = sorted(Path.cwd().iterdir())
    for option in ("--recording", "--ground-truth", "--camera", "--out"):
        assert "is empty" in refused("run", path, option, "")
    camera = ["--camera", tmp_path / "cam.yaml", "--n-lanes", 2]
    assert "--out: is empty" in refused("video", tmp_path / "drive.avi", *camera, "-o", "")
    assert sorted(Path.cwd().iterdir()) == before


@needs_links
def test_links_that_lead_nowhere_are_refused_before_anything_is_computed(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    (tmp_path / "to").symlink_to(tmp_path / "nothing")
    for out in (loop, tmp_path / "to"):
        assert f"{out}: is a link to nothing" in refused("run", path, "--out", out)
        assert f"{out} is a link to nothing" in refused("run", path, "--out", out / "x")
        with pytest.raises(InputError, match="is a link to nothing"):
            check_place(out / "a" / "b.json")
    assert "symbolic links" in refused("run", loop / "experiment.yaml")
    said = refused("convert", tmp_path / "lines.csv", loop / "lines.parquet")
    assert f"{loop / 'lines.parquet'}: cannot be written" in said
    (tmp_path / "own.py").symlink_to(tmp_path / "own.py")
    assert "no file" in refused("run", path, "--set", f"evidence={tmp_path / 'own.py'}")
    write_place(tmp_path, 3)
    words = ["video", tmp_path / "drive.avi", "--camera", tmp_path / "cam.yaml", "--n-lanes", 2]
    assert f"{loop}: cannot be created" in refused(*words, "-o", loop)


def test_a_file_that_is_read_is_not_written_over(tmp_path: Path) -> None:
    path, other = write_drive(tmp_path), write_drive(tmp_path / "other", name="other")
    before = contents(tmp_path)
    for name in ("experiment.yaml", "lines.csv", "ground_truth.txt"):
        target = tmp_path / name
        for words in (("run", path), ("run", path, other)):
            said = refused(*words, "--json", target, "--no-figures", "--out", tmp_path / "out")
            assert said == f"{target}: is read here; name another file"
    assert "is read here" in refused("compare", path, "--json", path)
    assert contents(tmp_path) == before


def test_recordings_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    path, out = write_drive(tmp_path), tmp_path / "out"
    places = [write_drive(tmp_path / day).with_name("lines.csv") for day in ("mon", "tue")]
    several = [word for place in places for word in ("--recording", place)]
    done("run", path, *several, "--no-figures", "--out", out)
    assert sorted(p.name for p in out.iterdir()) == ["mon_lines", "tue_lines"]
    again = tmp_path / "mon" / ".." / "mon" / "lines.csv"
    said = refused("run", path, *several, "--recording", again, "--out", out)
    assert said == f"--recording {again}: is named twice"
    # One recording, several experiments.
    other = write_drive(tmp_path / "other", name="other")
    words = ["--recording", places[0], "--no-figures", "--out", tmp_path / "both"]
    done("run", path, other, *words)
    assert sorted(p.name for p in (tmp_path / "both").iterdir()) == ["lines_drive", "lines_other"]
    assert refused("run", path, path, "--out", out) == f"{path}: is named twice"


def test_a_comparison_whose_numbers_cannot_be_written_is_printed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise InputError("x.json: cannot be written: No space left on device")

    path = write_drive(tmp_path)
    monkeypatch.setattr("egolane_pgm.cli.compare.write_json", full)
    result = command("compare", path, "--json", tmp_path / "x.json")
    assert result.exit_code == 2
    assert "| accuracy | drive" in result.stdout
    assert result.stderr == "egolane: x.json: cannot be written: No space left on device\n"


def test_ctrl_c_shows_the_recordings_that_were_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write_drive(tmp_path / name, name=name) for name in ("a", "b")]
    real = comparing.compare_groups

    def interrupted(groups: Sequence[comparing.Group], *given: Any, **named: Any) -> Iterator[Any]:
        yield next(iter(real(groups[:1], *given, **named)))
        raise KeyboardInterrupt

    monkeypatch.setattr("egolane_pgm.cli.compare.compare_groups", interrupted)
    result = command("compare", *paths, "--json", tmp_path / "x.json")
    assert result.exit_code == 130
    assert (
        result.stderr
        == "egolane: interrupted; this is 1 of 2 recordings; the same command begins anew\n"
    )
    assert "| a lines  |" in result.stdout
    assert len(json.loads((tmp_path / "x.json").read_text())["recordings"]) == 1


# --- what ends a command -------------------------------------------------------------------------


@needs_links
def test_ctrl_c_keeps_the_finished_runs_and_begins_no_other(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(textwrap.dedent(SLOW))
    own = {"evidence": str(tmp_path / "slow.py")}
    paths = [write_drive(tmp_path / name, name=name, **own) for name in ("fast", "b", "c", "d")]
    out = tmp_path / "out"
    running = started("run", *paths, "--no-figures", "--jobs", 2, "--out", out)
    wait_for(tmp_path / "b" / "lines.begun", tmp_path / "c" / "lines.begun", out / "fast")
    began = time.perf_counter()
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=30)
    assert time.perf_counter() - began < 5
    assert running.returncode == 130
    assert said == f"egolane: interrupted; 1 of 4 are in {out}; the same command begins anew\n"
    assert [p.name for p in out.iterdir()] == ["fast"]
    assert is_result(out / "fast")
    assert not (tmp_path / "d" / "lines.begun").exists()


@needs_links
@pytest.mark.parametrize("several", [False, True])
def test_a_reader_that_stops_reading_costs_nothing(tmp_path: Path, several: bool) -> None:
    paths = [write_drive(tmp_path / "a", name="a")]
    if several:
        paths.append(write_drive(tmp_path / "b", name="b"))
    target, out = tmp_path / "all.json", tmp_path / "out"
    running = started("run", *paths, "--no-figures", "--out", out, "--json", target)
    assert running.stdout is not None
    running.stdout.close()
    assert running.stderr is not None
    assert running.stderr.read() == ""
    running.wait()
    assert json.loads(target.read_text())
    assert is_result(out / "a" if several else out)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_to_a_full_disk_is_said_in_one_line(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    words = ["run", path, "--no-figures", "--out", tmp_path / "out", "--json", tmp_path / "a.json"]
    with Path("/dev/full").open("w") as full:
        ran = subprocess.run(
            [*MAIN, *map(str, words)], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert ran.returncode == 2
    assert ran.stderr == "egolane: output: No space left on device\n"
    assert is_result(tmp_path / "out")
    assert (tmp_path / "a.json").exists()


def test_a_result_is_kept_where_its_figures_cannot_be_drawn(tmp_path: Path) -> None:
    run = run_experiment(load_experiment(write_drive(tmp_path)))

    def draw(folder: Path) -> None:
        (folder / "figures").mkdir()
        (folder / "figures" / "half.png").touch()
        raise InputError(f"{folder / 'figures' / 'a.png'}: cannot be written: disk full")

    out = tmp_path / "out"
    with pytest.raises(InputError) as caught:
        save_run(run, out, draw)
    assert str(caught.value) == (
        f"{out}/figures/a.png: cannot be written: disk full; the result without figures is in {out}"
    )
    assert is_result(out)
    assert not (out / "figures").exists()


def test_what_could_not_be_written_is_named_by_its_place(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught, staged(tmp_path / "out") as folder:
        raise InputError(f"{folder / 'run.json'}: cannot be written")
    assert str(caught.value) == f"{tmp_path / 'out' / 'run.json'}: cannot be written"


def test_environments_without_home_terminal_or_temporary_folder_will_do(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    odd = {"HOME": "/nonexistent", "TERM": "dumb", "TMPDIR": "/nonexistent", "LC_ALL": "C"}
    ran = subprocess.run(
        [*MAIN, "run", str(path), "--no-figures", "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **odd},
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""


def test_jobs_are_at_least_one_and_never_more_than_there_is_to_do(tmp_path: Path) -> None:
    paths = [write_drive(tmp_path / name, name=name) for name in ("a", "b")]
    for jobs in (0, -1, "many"):
        assert "--jobs" in refused("run", *paths, "--jobs", jobs)
    words = ["--jobs", 1000, "--no-figures", "--out", tmp_path / "out"]
    assert command("run", *paths, *words).exit_code == 0
