"""Executes the notebooks: for the tests, and with `python -m tests.kits.notebooks` to store them
with what they put out."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from unittest import mock

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))

#: pgmpy warns of its own deprecated modules when it is imported; a bar is nothing to keep.
#: So is tqdm's advice to install the widgets of a bar.
QUIET = {
    "PYTHONWARNINGS": "ignore::FutureWarning:pgmpy.estimators,ignore:IProgress not found",
    "TQDM_DISABLE": "1",
}


#: The searches and drives of a notebook, and shorter ones for a test.
SHORTER = (
    ('"trials": 150', '"trials": 25'),
    ('"fit.trials": 100', '"fit.trials": 12'),
    ("[0, 5000]", "[0, 1600]"),
)


def shorter(source: str) -> str:
    """The code of a cell with short searches and drives."""
    for long, short in SHORTER:
        source = source.replace(long, short)
    return source


def execute(
    path: Path, folder: Path | str, *, is_short: bool = False, **environment: str
) -> NotebookNode:
    """Run a notebook from top to bottom in a fresh kernel.

    - folder: that its cells stand in, and may write to.
    - is_short: whether it searches less than it says.
    - environment: variables of the kernel.

    Raises nbclient's CellExecutionError where a cell fails.
    """
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells if is_short else ():
        cell.source = shorter(cell.source)
    with mock.patch.dict(os.environ, {**QUIET, **environment}):
        resources = {"metadata": {"path": str(folder)}}
        NotebookClient(notebook, timeout=300, record_timing=False, resources=resources).execute()
    return notebook


def store(path: Path) -> None:
    """Execute a notebook, and write it with its outputs.

    The same outputs give the same file: what is known of the kernel, the time and the machine is
    left out.
    """
    with tempfile.TemporaryDirectory() as folder:
        # A link, so that warnings name the recordings by `data/`.
        (Path(folder) / "data").symlink_to(os.path.abspath(os.environ["EGOLANE_DATA"]))
        notebook = execute(path, folder, EGOLANE_DATA="data")
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for k, cell in enumerate(notebook.cells):
        cell.id, cell.metadata = f"cell-{k}", {}
    nbformat.write(notebook, path)
    print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    if not os.environ.get("EGOLANE_DATA"):
        raise SystemExit("notebooks: are stored with the paper's recordings, set EGOLANE_DATA")
    for each in NOTEBOOKS:
        store(each)
