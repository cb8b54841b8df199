"""What a package that is not installed is missed by, and in which words."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

from egolane_pgm.maps.lane_graph import Plane
from egolane_pgm.maps.osm import read_osm
from egolane_pgm.maps.positions import read_positions
from egolane_pgm.tools.jobs import parallel
from egolane_pgm.types import InputError
from egolane_pgm.verbs.plot import plot
from egolane_pgm.vision.detectors.networks.running import read_onnx
from tests.kits.drives import run, write_drive
from tests.kits.tiny_result import a_result

#: The modules that import an extra's packages when they are imported themselves.
AT_ONCE = ("page.document", "page.timeline", "export.mcap_file")


def exported(file: Path) -> None:
    plot(run(write_drive(file.parent, 20)).save(file.parent / "result"), out=file)


def cluster(_: Path) -> None:
    list(parallel(abs, [1], cluster="nowhere"))


def page(place: Path) -> None:
    import_module("egolane_pgm.page.document").write_page([a_result()], place)


def position(_: Path) -> None:
    Plane(45.0, 9.0).metres([45.0], [9.0])


@pytest.mark.parametrize(
    ("module", "file", "call", "words"),
    [
        ("bokeh", "a.html", page, "a page of results needs bokeh|page"),
        ("mcap", "a.mcap", exported, "an .mcap file needs mcap|mcap"),
        ("osmium", "a.osm", read_osm, "{} needs osmium|maps"),
        ("gpxpy", "a.gpx", read_positions, "{} needs gpxpy|maps"),
        ("pyproj", "", position, "a position on a map needs pyproj|maps"),
        ("onnx", "a.onnx", lambda p: read_onnx(p, "net.yaml"), "net.yaml: {} needs onnx|vision"),
        ("distributed", "", cluster, "a cluster needs distributed|cluster"),
    ],
)  # fmt: skip
def test_a_package_that_is_not_installed_is_named_with_its_extra(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    module: str,
    file: str,
    call: Callable[[Path], object],
    words: str,
) -> None:
    for name in AT_ONCE:
        monkeypatch.delitem(sys.modules, f"egolane_pgm.{name}", raising=False)
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    place = tmp_path / file
    if file.endswith((".osm", ".gpx", ".onnx")):
        place.touch()
    with pytest.raises(InputError) as caught:
        call(place)
    said, _, extra = words.format(place).partition("|")
    assert str(caught.value) == f"{said}: pip install 'egolane-pgm[{extra}]'"
