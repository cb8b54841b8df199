"""The examples in the docstrings of all public objects."""

from __future__ import annotations

import doctest
import os
from pathlib import Path

import pytest

import egolane_pgm


@pytest.mark.parametrize("name", egolane_pgm.__all__)
def test_every_public_object_has_an_example_that_runs_from_any_folder(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    public = getattr(egolane_pgm, name)
    finder = doctest.DocTestFinder(recurse=False)
    (example,) = finder.find(public, name, module=False, globs={})
    assert example.examples, f"{name} has no example"
    if (Path(os.environ.get("EGOLANE_DATA", "")) / "rle").is_dir():
        for each in example.examples:
            # These need the paper's recordings.
            each.options.pop(doctest.SKIP, None)
    found = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(example)
    assert not found.failed, capsys.readouterr().out
    assert not any(tmp_path.iterdir()), "an example leaves files behind"
