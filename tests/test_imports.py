"""What an import costs, and which module may import which."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEAVY = {
    "numpy",
    "pgmpy",
    "numba",
    "matplotlib",
    "cv2",
    "pyarrow",
    "rosbags",
    "scipy",
    "pandas",
    "optuna",
    "bokeh",
    "jinja2",
}


def modules_after(code: str) -> set[str]:
    """The top-level modules that a fresh Python has loaded after running `code`."""
    program = f"import json, sys\n{code}\nprint(json.dumps(sorted(sys.modules)), file=sys.stderr)"
    ran = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120
    )
    return {name.partition(".")[0] for name in json.loads(ran.stderr.splitlines()[-1])}


@pytest.mark.parametrize(
    ("words", "allowed"),
    [
        (["--help"], set()),
        (["data", "-h"], {"numpy"}),
        # What this command always uses: tables of frames, and numba with scipy.
        (["run", "--help"], {"numpy", "numba", "scipy", "pandas", "pyarrow"}),
    ],
)
def test_help_loads_nothing_heavy(words: list[str], allowed: set[str]) -> None:
    loaded = modules_after(
        "from egolane_pgm.command import egolane\n"
        f"try: egolane({words!r})\n"
        "except SystemExit as end: assert end.code == 0"
    )
    assert "egolane_pgm" in loaded
    assert not loaded & (HEAVY - allowed)


def test_importing_the_package_loads_nothing_heavy() -> None:
    assert not modules_after("import egolane_pgm; egolane_pgm.__version__") & HEAVY


def test_a_run_does_not_import_pgmpy(tmp_path: Path) -> None:
    words = ["run", str(ROOT / "experiments" / "quickstart.yaml"), "--no-figures"]
    loaded = modules_after(
        "from egolane_pgm.command import egolane\n"
        f"try: egolane({[*words, '--out', str(tmp_path / 'out')]!r})\n"
        "except SystemExit as end: assert end.code == 0"
    )
    assert "numba" in loaded
    assert not loaded & {"pgmpy", "sklearn", "matplotlib", "optuna", "bokeh"}
