"""The page "Plugins" of the reference has every field of every contract, and its examples run."""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm import contracts
from egolane_pgm.contracts import Detector, Graph, Plugin, Reader, Rule
from egolane_pgm.model import compile_graph, matching_evidence_rule
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.plugins import load_plugin
from egolane_pgm.simulation import simulate
from egolane_pgm.vision.camera.picture import Picture
from tests.kits.calibration_kit import TRUE, draw_road
from tests.kits.sensor_files import OFFSETS, polynomials_table

ROOT = Path(__file__).parents[2]

#: The names in a user's module, typed here so that a renamed or a new field shows.
NAMES = {
    Graph: "PARAMETERS tables build HIDDEN OBSERVED INPUTS BOUNDS UNUSED VALUES LEARNED_FROM",
    Rule: "PARAMETERS evidence PROVIDES INPUTS TENTATIVE online looks_ahead fit LEARNED",
    Detector: "PARAMETERS STEREO start",
    Reader: "PARAMETERS read",
}
KINDS = pytest.mark.parametrize("kind", NAMES, ids=lambda kind: kind.__name__)


@pytest.fixture(scope="module")
def page() -> Iterator[str]:
    sys.path.insert(0, str(ROOT / "docs" / "building"))
    import reference

    yield reference.contracts_page()
    sys.path.pop(0)


def section(page: str, kind: type[Plugin]) -> str:
    [text] = re.findall(rf"^## {kind.__name__}\n(.*?)(?=^## )", page, flags=re.M | re.S)
    return str(text)


def example(page: str, kind: type[Plugin]) -> str:
    [code] = re.findall(r"^````python\n(.*?)^````", section(page, kind), flags=re.M | re.S)
    return str(code)


@KINDS
def test_each_field_has_a_row_with_type_and_meaning_and_each_function_its_signature(
    page: str, kind: type[Plugin]
) -> None:
    text = section(page, kind)
    rows = re.findall(r"^\| `(\w+)` \| (.+) \| (needed|optional) \| (.+) \|$", text, flags=re.M)
    of_file = {"name", "file", "about", "is_ours", "keys"}
    fields = {f.name for f in dataclasses.fields(kind)} - of_file
    assert {name.lower() for name, *_ in rows} == fields
    assert [name for name, *_ in rows] == NAMES[kind].split()
    functions = {name for name, *_ in rows if name.islower()}
    assert set(re.findall(r"^### (\w+)$", text, flags=re.M)) == functions
    for name in functions:
        signature, about = re.findall(
            rf"^### {name}\n\n```python\ndef {name}(\(.+\) -> .+)\n```\n\n(.+)", text, flags=re.M
        )[0]
        assert not re.search(r"self|/|'", signature)
        assert len(about) > 30


def test_all_contracts_are_on_the_page() -> None:
    kinds = {each for each in vars(contracts).values() if isinstance(each, type)}
    assert {each for each in kinds if issubclass(each, Plugin)} - {Plugin} == set(NAMES)


@KINDS
def test_the_example_of_a_kind_loads_and_runs(
    page: str, kind: type[Plugin], tmp_path: Path
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(example(page, kind))
    plugin = load_plugin(kind, str(file), "mine")
    values = resolve_parameters(plugin.parameters, {}, 3)
    log = simulate("quickstart", seed=3, frames=20).log
    if isinstance(plugin, Graph):
        rule = load_plugin(Rule, matching_evidence_rule(plugin, 3, "counting", "mine"), "mine")
        compiled, _ = compile_graph(rule, plugin, 3, values)
        assert compiled.hidden == ("Lane", "SensorState")
    elif isinstance(plugin, Rule):
        found = plugin.evidence(log, 3, values)
        assert set(found.likelihoods) == set(plugin.provides)
        assert found.likelihoods["DetectorOutput"].shape == (20, 3)
    elif isinstance(plugin, Detector):
        step = plugin.start(TRUE, values)
        for k in range(12):
            lines = step(Picture(k, draw_road(TRUE, np.array([-1.75, 1.75]), 0.0, k)))
        np.testing.assert_allclose(lines.offset_m, [-1.75, 1.75], atol=0.15)
        assert lines.is_valid.all()
    else:
        assert isinstance(plugin, Reader)
        polynomials_table(tmp_path / "drive.csv")
        table = plugin.read(tmp_path / "drive.csv", frame_rate=10.0)
        np.testing.assert_allclose(table["offset_1"], OFFSETS[:, 1])
