"""`egolane plot`: figures, a page and an MCAP file of results, and what it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.kits.drives import done, refused, run_json, write_drive


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result, without figures."""
    folder = tmp_path_factory.mktemp("report")
    done("run", write_drive(folder / "drive"), "--no-figures", "--out", folder / "result")
    return folder / "result"


def test_figures_are_drawn_into_the_result(saved: Path, tmp_path: Path) -> None:
    shutil.copytree(saved, tmp_path / "out")
    shown = done("plot", tmp_path / "out", "--frames", 10, 60, "--style", "svg").stdout
    figures = [Path(line) for line in shown.splitlines()]
    assert all(f.suffix == ".svg" and f.stat().st_size > 1000 for f in figures)
    assert {f.stem for f in figures} == {"strips", "confusion", "reliability"}
    assert figures[0] == tmp_path / "out" / "figures" / "strips.svg"


def test_several_results_make_one_sheet(saved: Path, tmp_path: Path) -> None:
    drive = saved.parent / "drive" / "experiment.yaml"
    run_json(drive, tmp_path / "b", "--set", "name=b")
    shown = done("plot", saved, tmp_path / "b" / "out", "--out", tmp_path / "figures")
    figures = {str(Path(line).relative_to(tmp_path / "figures")) for line in shown.stdout.split()}
    assert {"dispersion.png", "out/strips.png", "result/strips.png"} <= figures
    assert all((tmp_path / "figures" / name).is_file() for name in figures)


def test_a_check_prints_its_table_above_the_files(saved: Path, tmp_path: Path) -> None:
    shown = done("plot", saved, saved, "--check", "--out", tmp_path / "new").stdout.splitlines()
    title = "drive: does the model look like the data?"
    assert (shown[0], shown.count(title)) == (title, 2)
    figure = tmp_path / "new" / "result" / "check.png"
    assert shown[-2:] == [str(figure)] * 2
    assert figure.stat().st_size > 5000


def test_the_ending_chooses_a_page_or_an_mcap_file(saved: Path, tmp_path: Path) -> None:
    for name, begins in (("page.html", b"<!DOCTYPE html>"), ("x.mcap", b"\x89MCAP")):
        target = tmp_path / name
        assert done("plot", saved, "--out", target).stdout == f"{target}\n"
        assert target.read_bytes().lstrip().startswith(begins)
    both = tmp_path / "both.html"
    shutil.copytree(saved, tmp_path / "other")
    done("plot", saved, tmp_path / "other", "--out", both)
    assert both.stat().st_size < 3e6


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("{0}/gone --out {1}/page.html", "gone: is not a result directory"),
        ("{1} --out {1}/page.html", "{1}: is not a result directory"),
        ("{1}/half --out {1}/page.html", "{1}/half"),
        ("{0} --out {1}/page.html --frames 0 9", "--frames: does not go with a page"),
        ("{0} --frames 9 0", "--frames: 9 0 is an empty range"),
        ("{0} {0} --out {1}/x.mcap", "--out: {1}/x.mcap: shows one result; 2 are named"),
        ("{0} --out {1}/x.mp4", "pictures"),
        ("{1}/study --frames 0 9", "--frames: goes with results; the figures of a study have no"),
        ("{0} --check --frames 0 9", "--check: goes with figures of results, without frames"),
        ("{1}/study --check", "--check: goes with figures of results"),
        ("{0} --check --out {1}/page.html", "--check: goes with figures of results"),
        ("{1}/linked", "{1}/linked/figures: is a link; name another path"),
        ("{1}/study --out {1}/page.html", "{1}/study: is not a result directory"),
    ],
)
def test_results_that_cannot_be_drawn_are_refused_in_one_line(
    saved: Path, tmp_path: Path, words: str, message: str
) -> None:
    shutil.copytree(saved, tmp_path / "half")
    (tmp_path / "half" / "beliefs.parquet").unlink()
    (tmp_path / "study").mkdir()
    shutil.copytree(saved, tmp_path / "linked", ignore=shutil.ignore_patterns("figures"))
    (tmp_path / "linked" / "figures").symlink_to(tmp_path / "study")
    (tmp_path / "study" / "study.json").write_text("{}")
    places = (saved, tmp_path)
    assert message.format(*places) in refused("plot", *words.format(*places).split())
    assert not list(tmp_path.glob("*.*"))
