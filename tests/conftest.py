"""What the tests of several modules share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

from tests.kits.calibration_kit import write_boards, write_stills
from tests.kits.drives import write_drive
from tests.kits.synthetic_road import write_place

# The first example of a kernel waits for its compiler, so that no example has a time limit. A
# submission's tests must not depend on luck; elsewhere each run tries new examples.
settings.register_profile("ours", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "ours")

# A search shares itself out to all cores by default; processes of its own cost seconds each time.
os.environ["LOKY_MAX_CPU_COUNT"] = "1"

#: For tests that would take minutes when the kernels are interpreted.
needs_compiler = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"),
    reason="whole recordings take too long with the compiler switched off (NUMBA_DISABLE_JIT)",
)

#: What takes longest, begun first: processes that share the tests by files then end together.
SLOWEST = (
    *("docs/test_examples.py", "makers/test_benchmark.py", "studies/test_study.py"),
    *("evidence/line_geometry/test_rule.py", "evidence/line_geometry/test_flag_semantics.py"),
    *("studies/test_search.py", "test_frozen.py", "test_paper.py", "test_notebooks.py"),
    *("test_online.py", "test_running.py", "test_labelling.py", "evidence/line_geometry/"),
    *("test_dist.py", "makers/"),
    *("docs/", "tools/test_jobs.py", "studies/", "vision/detectors/", "verbs/test_tune.py"),
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the slowest files first."""

    def place(item: pytest.Item) -> int:
        file = item.nodeid.removeprefix("tests/")
        return next((k for k, name in enumerate(SLOWEST) if file.startswith(name)), len(SLOWEST))

    items.sort(key=place)


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder that holds `rle/` with the paper's recordings."""
    if not os.environ.get("EGOLANE_DATA"):
        pytest.skip("the paper's recordings: needs EGOLANE_DATA")
    folder = Path(os.environ["EGOLANE_DATA"])
    if not (folder / "rle").is_dir():
        pytest.skip(f"the paper's recordings: needs EGOLANE_DATA, {folder} has no folder rle")
    return folder


@pytest.fixture(scope="session")
def real_pictures() -> Path:
    """The folder of real pictures."""
    folder = Path(os.environ.get("EGOLANE_DATA", "")) / "camera"
    if not os.environ.get("EGOLANE_DATA") or not folder.is_dir():
        pytest.skip("real pictures: needs EGOLANE_DATA with a folder camera")
    return folder


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The experiment of a short simulated drive, its files beside it."""
    return write_drive(tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with drive.avi, cam.yaml and run.yaml."""
    return write_place(tmp_path_factory.mktemp("camera"))


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pictures of a chessboard."""
    return write_boards(tmp_path_factory.mktemp("boards"))


@pytest.fixture(scope="module")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pictures of a straight road."""
    return write_stills(tmp_path_factory.mktemp("stills"))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests were skipped for want of the recordings."""
    skipped = terminalreporter.stats.get("skipped", [])
    absent = [report for report in skipped if "EGOLANE_DATA" in str(report.longrepr)]
    terminalreporter.write_line(f"{len(absent)} tests skipped for absent data (EGOLANE_DATA)")
