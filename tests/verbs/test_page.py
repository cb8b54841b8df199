"""The page, `egolane plot --out x.html`: what it writes and says, and what it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.kits.drives import done, refused, write_drive


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result, without figures."""
    folder = tmp_path_factory.mktemp("report")
    drive = write_drive(folder / "drive")
    done("run", drive, "--no-figures", "--out", folder / "result")
    return folder / "result"


def test_the_page_of_a_result_is_whole(saved: Path, tmp_path: Path) -> None:
    target = tmp_path / "new" / "page.html"
    assert done("plot", saved, "--out", target).stdout == f"{target}\n"
    page = target.read_text()
    # A page is too long to be shown by a failing assertion.
    head = page[:1000]
    assert "<title>drive</title>" in head
    assert 'name="viewport"' in head
    assert len(page) < 3e6


def test_the_page_of_several_results_tells_them_apart(saved: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(saved, other)
    done("plot", saved, other, "--out", tmp_path / "both.html")
    page = (tmp_path / "both.html").read_text()
    # Results of the same name are told apart by their directories.
    assert page.find(f"drive ({saved})") > 0
    assert page.find(f"drive ({other})") > 0


def test_what_is_no_result_is_refused_in_one_line(saved: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "page.html")
    for place in (tmp_path / "gone", tmp_path):
        assert f"{place}: is not a result directory" in refused("plot", place, *out)
    assert "--frames: does not go with a page" in refused("plot", saved, *out, "--frames", 0, 9)
    assert "is an empty range" in refused("plot", saved, *out, "--frames", 9, 0)
    said = refused("plot", saved, saved, "--out", tmp_path / "x.mcap")
    assert said.endswith("x.mcap: shows one result; 2 are named")
    half = tmp_path / "half"
    shutil.copytree(saved, half)
    (half / "beliefs.parquet").unlink()
    assert str(half) in refused("plot", half, *out)
    (half / "scores.json").unlink()
    assert str(half) in refused("plot", half, *out)
    assert not (tmp_path / "page.html").exists()


def test_a_folder_of_results_or_a_study_says_what_to_name_instead(
    saved: Path, tmp_path: Path
) -> None:
    out = ("--out", tmp_path / "page.html")
    shutil.copytree(saved, tmp_path / "folder" / "recording" / "a")
    assert refused("plot", tmp_path / "folder", *out) == (
        f"{tmp_path / 'folder'}: is a folder of 1 result(s); name those that you mean, e.g."
        f" {tmp_path / 'folder' / 'recording' / 'a'}"
    )
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "study.json").write_text("{}")
    assert "is a study of parameters" in refused("plot", tmp_path / "study", *out)
