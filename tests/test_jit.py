from __future__ import annotations

import os
import shutil
from pathlib import Path

import egolane_pgm
from tests.kits.drives import write_drive
from tests.kits.processes import ended


def test_kernels_are_compiled_where_nothing_can_be_kept(tmp_path: Path) -> None:
    """A read-only package with a read-only home."""
    package = Path(egolane_pgm.__file__).parent
    copy = tmp_path / "site" / "egolane_pgm"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__", "_experiments"))
    # Permissions would not keep the administrator from writing.
    for folder in [copy, *(path for path in copy.rglob("*") if path.is_dir())]:
        (folder / "__pycache__").touch()
    home = tmp_path / "home"
    home.touch()
    places = dict.fromkeys(("HOME", "USERPROFILE", "LOCALAPPDATA", "XDG_CACHE_HOME"), str(home))
    given = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    experiment = write_drive(tmp_path)
    words = ["run", experiment, "--no-figures", "--out", tmp_path / "out"]
    ran = ended(*words, cwd=tmp_path, env={**given, **places, "PYTHONPATH": str(copy.parent)})
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""
    assert (tmp_path / "out" / "run.json").exists()
