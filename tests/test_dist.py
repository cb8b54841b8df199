"""The wheel and the source archive, away from the repository."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tarfile
from email import message_from_bytes
from pathlib import Path
from zipfile import ZipFile

import pytest
import yaml

from egolane_pgm import __version__

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.skipif(
    not all(map(importlib.util.find_spec, ("build", "hatchling"))),
    reason="building needs the packages build and hatchling",
)


def python(*words: object, **options: object) -> subprocess.CompletedProcess[str]:
    """`python words...` in a process of its own, with what it says."""
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, **options)  # type: ignore[call-overload, no-any-return]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The source archive of the repository, and the wheel that is built from it."""
    out = tmp_path_factory.mktemp("dist")
    ran = python("-m", "build", "--no-isolation", "--outdir", out, ROOT)
    assert ran.returncode == 0, ran.stderr
    (archive,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return archive, wheel


def test_the_source_archive_holds_every_file_but_pictures_of_results(
    built: tuple[Path, Path],
) -> None:
    archive, _ = built
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("which files belong to the repository: needs git and a clone")
    with tarfile.open(archive) as opened:
        held = {name.partition("/")[2] for name in opened.getnames()}
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    left_out = set(listed.stdout.decode().strip("\0").split("\0")) - held
    assert left_out
    assert all(Path(name).match("results/*/*.png") for name in left_out)


def test_the_wheel_says_what_it_is(built: tuple[Path, Path]) -> None:
    _, wheel = built
    with ZipFile(wheel) as opened:
        [place] = {name.partition("/")[0] for name in opened.namelist() if ".dist-info/" in name}
        assert opened.read(f"{place}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
        said = message_from_bytes(opened.read(f"{place}/METADATA"))
    assert said["License-Expression"] == "BSD-3-Clause"
    assert "Typing :: Typed" in said.get_all("Classifier", [])
    needed = [each for each in said.get_all("Requires-Dist", []) if "extra ==" not in each]
    assert len(needed) <= 16
    assert any(re.fullmatch(r"pgmpy<[\d.]+,>=[\d.]+", each) for each in needed)


def test_all_files_agree_on_the_version() -> None:
    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert re.search(r"^## \[(\d[^]]*)\]", changelog, re.MULTILINE)[1] == __version__  # type: ignore[index]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == __version__


def test_the_wheel_holds_the_package_and_its_experiments_only(built: tuple[Path, Path]) -> None:
    _, wheel = built
    with ZipFile(wheel) as opened:
        names = opened.namelist()
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"egolane_pgm"}
    shipped = {name.removeprefix("egolane_pgm/_experiments/") for name in names}
    experiments = ROOT / "experiments"
    assert shipped >= {p.relative_to(experiments).as_posix() for p in experiments.rglob("*.yaml")}


def test_the_installed_wheel_does_the_main_job_where_nothing_else_can_be_written(
    built: tuple[Path, Path], tmp_path: Path
) -> None:
    """From an empty folder, the package and the home read-only."""
    site, home, here = tmp_path / "site", tmp_path / "home", tmp_path / "here"
    words = ("--no-deps", "--no-compile", "--no-index", "--target", site, built[1])
    ran = python("-m", "pip", "install", "--disable-pip-version-check", *words)
    assert ran.returncode == 0, ran.stderr
    # Permissions would not keep the administrator from writing.
    for folder in [path for path in (site / "egolane_pgm").rglob("*") if path.is_dir()]:
        (folder / "__pycache__").touch()
    (site / "egolane_pgm" / "__pycache__").touch()
    home.touch()
    here.mkdir()
    places = dict.fromkeys(("HOME", "USERPROFILE", "LOCALAPPDATA", "XDG_CACHE_HOME"), str(home))
    given = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "EGOLANE_DATA")}
    environment = {**given, **places, "PYTHONPATH": str(site)}
    program = (
        "import sys, egolane_pgm; from egolane_pgm.command import main;"
        f" assert egolane_pgm.__file__.startswith({str(site)!r}); main()"
    )
    # Kernels are declared though what is compiled cannot be kept; compiling them takes a minute.
    kernels = "import egolane_pgm.inference.filtering, egolane_pgm.evidence.line_geometry.rule"
    ran = python("-c", kernels, cwd=here, env=environment)
    assert ran.returncode == 0, ran.stderr
    environment["NUMBA_DISABLE_JIT"] = "1"
    ran = python("-c", program, "run", "experiments/quickstart.yaml", cwd=here, env=environment)
    assert ran.returncode == 0, ran.stderr
    assert "right in 86.9 % of" in ran.stdout
    assert (here / "results" / "quickstart" / "figures" / "strips.png").is_file()
