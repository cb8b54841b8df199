"""The notebooks run from top to bottom in a fresh kernel, and are kept with what they put out."""

from __future__ import annotations

import os
import re
from pathlib import Path

import nbformat
import pytest
from nbformat import NotebookNode

from tests.kits.notebooks import NOTEBOOKS, execute, shorter

#: Those that take a simulated drive where the recordings are missing.
ON_RECORDINGS = [path for path in NOTEBOOKS if "try:" in path.read_text()]


def of_each(paths: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("path", paths, ids=lambda path: path.stem)


def code(path: Path) -> list[NotebookNode]:
    """The code cells that a notebook is kept with."""
    return [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]


def has_picture(cell: NotebookNode) -> bool:
    return any("image/png" in output.get("data", {}) for output in cell.outputs)


@of_each(NOTEBOOKS)
def test_a_notebook_runs_from_top_to_bottom(path: Path, tmp_path: Path) -> None:
    data = os.environ.get("EGOLANE_DATA") if path in ON_RECORDINGS else None
    place = os.path.abspath(data) if data else ""
    found = execute(path, tmp_path, is_short=True, EGOLANE_DATA=place)
    kept, cells = code(path), [cell for cell in found.cells if cell.cell_type == "code"]
    assert list(map(has_picture, cells)) == list(map(has_picture, kept))
    assert not [o.text for cell in cells for o in cell.outputs if o.get("name") == "stderr"]


@of_each(ON_RECORDINGS)
def test_without_the_recordings_a_notebook_takes_a_simulated_drive(
    path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Up to the cell that chooses."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("EGOLANE_DATA", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cells = [cell.source for cell in code(path)]
    choice = next(k for k, source in enumerate(cells) if "try:" in source)
    lines = shorter("\n".join(cells[: choice + 1]))
    exec(compile(lines, path.name, "exec"), {})
    assert "SIMULATED" in capsys.readouterr().out


@of_each(NOTEBOOKS)
def test_a_notebook_is_kept_as_it_was_executed_once_from_top_to_bottom(path: Path) -> None:
    cells = code(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    kinds = {output.output_type for cell in cells for output in cell.outputs}
    assert kinds <= {"stream", "display_data", "execute_result"}
    for cell in cells:
        last = cell.source.rstrip().splitlines()[-1]
        if re.search(r"\bplot\(|draw_network\(|^Image\(", last):
            assert has_picture(cell), last
    assert any(map(has_picture, cells))
    assert path.stat().st_size < 400_000


@of_each(NOTEBOOKS)
def test_a_kept_notebook_says_nothing_of_the_machine_and_has_no_warnings(path: Path) -> None:
    for cell in code(path):
        assert not cell.metadata
        for output in cell.outputs:
            assert output.get("name") != "stderr"
            shown = [v for k, v in output.get("data", {}).items() if k.startswith("text/")]
            said = "".join([output.get("text", ""), *shown])
            paths = re.findall(r"(?<![\w.<])/\w\S*", said)
            assert not paths
