"""`egolane report`: what it writes and says, and what it refuses."""

from __future__ import annotations

import shutil
import time
import webbrowser
from pathlib import Path

import pytest

from egolane_pgm.page.document import page_of
from tests.kits.drives import contents, done, refused, write_drive
from tests.kits.tiny_result import long_drive


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result, without figures."""
    folder = tmp_path_factory.mktemp("report")
    drive = write_drive(folder / "drive")
    done("run", drive, "--no-figures", "--out", folder / "result")
    return folder / "result"


def test_the_page_of_a_result_lies_in_it_and_is_whole(saved: Path, tmp_path: Path) -> None:
    result = tmp_path / "result"
    shutil.copytree(saved, result)
    said = done("report", result).stdout
    page = (result / "report.html").read_text()
    # A page is too long to be shown by a failing assertion.
    head = page[:1000]
    assert said.startswith(f"{result / 'report.html'}: ")
    assert "<title>drive</title>" in head
    assert 'name="viewport"' in head
    assert len(page) < 3e6
    assert set(contents(result)) - set(contents(saved)) == {"report.html"}


def test_the_page_of_several_results_is_written_where_it_is_asked_for(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / "other"
    shutil.copytree(saved, other)
    done("report", saved, other, "-o", tmp_path / "new" / "both.html")
    page = (tmp_path / "new" / "both.html").read_text()
    # Results of the same name are told apart by their directories.
    assert page.find(f"drive ({saved})") > 0
    assert page.find(f"drive ({other})") > 0
    monkeypatch.chdir(tmp_path)
    assert done("report", saved, other).stdout.startswith("report.html: ")


def test_open_shows_the_page_or_says_that_it_cannot(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: shown.append(url) or True)
    file = tmp_path / "a b.html"
    done("report", saved, "-o", file, "--open")
    assert shown == [file.as_uri()]
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    with pytest.raises(AssertionError):
        done("report", saved, "-o", file, "--open")


def test_what_is_no_result_is_refused_in_one_line(saved: Path, tmp_path: Path) -> None:
    for place in (tmp_path / "gone", tmp_path):
        assert f"{place}: is not a result directory" in refused("report", place)
    assert "ends in .html" in refused("report", saved, "-o", tmp_path / "page.png")
    half = tmp_path / "half"
    shutil.copytree(saved, half)
    (half / "beliefs.parquet").unlink()
    assert str(half) in refused("report", half, "-o", tmp_path / "page.html")
    (half / "scores.json").unlink()
    assert str(half) in refused("report", half, "-o", tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_a_folder_of_results_or_a_study_says_what_to_name_instead(
    saved: Path, tmp_path: Path
) -> None:
    shutil.copytree(saved, tmp_path / "folder" / "recording" / "a")
    assert refused("report", tmp_path / "folder") == (
        f"{tmp_path / 'folder'}: is a folder of 1 result(s); name those that you mean, e.g."
        f" {tmp_path / 'folder' / 'recording' / 'a'}"
    )
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "study.json").write_text("{}")
    assert "is a study of parameters" in refused("report", tmp_path / "study")


def test_ten_thousand_frames_make_a_small_page_and_cost_little_more_than_a_hundred() -> None:
    def cost(n_frames: int) -> tuple[float, int]:
        result, times = long_drive(n_frames), []
        # The least of three: another process may slow one of them.
        for _ in range(3):
            begin = time.thread_time()
            page, _ = page_of([result])
            times.append(time.thread_time() - begin)
        return min(times), len(page)

    (short_s, short), (long_s, long) = cost(100), cost(10_000)
    assert long_s < 3 * short_s + 0.3
    assert short < long < 6_000_000


def test_a_new_result_does_not_keep_the_page_of_an_old_one(saved: Path, tmp_path: Path) -> None:
    result = tmp_path / "result"
    done("run", saved / "experiment.yaml", "--no-figures", "--out", result)
    done("report", result)
    (result / "notes.txt").write_text("mine")
    done("run", saved / "experiment.yaml", "--no-figures", "--out", result)
    assert not (result / "report.html").exists()
    assert (result / "notes.txt").exists()
