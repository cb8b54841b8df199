"""Every example of README.md and docs/ runs: Python, command lines, YAML."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pkgutil
import re
import shutil
from pathlib import Path
from typing import Any

import click
import pytest
import yaml
from jsonschema import Draft202012Validator

from egolane_pgm.command import egolane
from egolane_pgm.verbs.schema import schema
from egolane_pgm.vision.detectors.networks.description import Network
from tests.kits.doc_examples import (
    PAGES,
    ROOT,
    Block,
    blocks_of,
    commands_of,
    is_run,
    run_line,
    write_world,
    yaml_kind,
)

#: Data that a page needs, by what it mentions.
_RECORDINGS = re.compile(r"ten_runs|reproduce|experiments/(?:paper|tuning)/|egolane data")
_MAPS = re.compile(r"roads\.osm|drive\.gpx")


@pytest.fixture(scope="module")
def world(boards: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("world")
    write_world(folder, boards)
    return folder


def of_pages(pages: list[Path]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("page", pages, ids=lambda page: str(page.relative_to(ROOT)))


def needed(page: Path) -> list[str]:
    """The data that the examples of a page need and that are missing."""
    data = Path(os.environ.get("EGOLANE_DATA") or "nowhere")
    text = "\n".join(block.text for block in blocks_of(page))
    folders = [("rle", _RECORDINGS), ("maps", _MAPS)]
    return [
        name for name, pattern in folders if pattern.search(text) and not (data / name).is_dir()
    ]


@of_pages([page for page in PAGES if any(b.language in ("", "python") for b in blocks_of(page))])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_examples_of_a_page_run_in_their_order(
    page: Path, world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lacking = needed(page)
    if lacking:
        pytest.skip(f"needs EGOLANE_DATA with {', '.join(lacking)}")
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("BROWSER", "true")
    folder = tmp_path / "world"
    shutil.copytree(world, folder, symlinks=True)
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    blocks = blocks_of(page)
    for block, after in zip(blocks, [*blocks[1:], None], strict=True):
        for line in filter(is_run, commands_of(block)):
            run_line(line)
        if block.language == "python":
            code = compile(block.text, f"{page}:{block.line}", "exec")
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                if not is_outline(block):
                    exec(code, names)
            if after is not None and after.language == "output":
                assert printed.getvalue() == after.text, f"{page}:{after.line}"
    if page.name == "README.md":
        scores = names["run"].scores
        assert scores["model"]["accuracy"] > scores["detector"]["accuracy"] + 0.1


def is_outline(block: Block) -> bool:
    """Whether Python leaves parts out, as `...` among the arguments of a call."""
    return bool(re.search(r"^\s+\.\.\.$", block.text, flags=re.M))


@of_pages([page for page in PAGES if any(block.language == "yaml" for block in blocks_of(page))])
def test_the_yaml_of_a_page_fits_its_schema(page: Path) -> None:
    for block in blocks_of(page):
        if block.language == "yaml":
            content = json.loads(json.dumps(yaml.safe_load(block.text)))
            if "layout" in content:
                Network(**content)
                continue
            validator = Draft202012Validator(schema(yaml_kind(content)))
            problems = [error.message for error in validator.iter_errors(content)]
            assert not problems, f"{page}:{block.line}"


#: Texts with code in sentences and messages.
SENTENCES = {
    path: path.read_text() for path in (*PAGES, *sorted((ROOT / "egolane_pgm").rglob("*.py")))
}


def test_names_of_python_in_sentences_exist() -> None:
    def exists(name: str) -> bool:
        try:
            return pkgutil.resolve_name(name) is not None
        except (ImportError, AttributeError):
            return False

    texts = [re.sub(r"^```.*?^```", "", t, flags=re.M | re.S) for t in SENTENCES.values()]
    names = set(re.findall(r"\b(?:ego|egolane_pgm)((?:\.\w+)+)", "\n".join(texts)))
    assert len(names) > 100
    assert not [name for name in names if not exists(f"egolane_pgm{name}")]


def test_commands_and_options_exist() -> None:
    found = {
        each: path.name
        for path, text in SENTENCES.items()
        for each in re.findall(r"(?:^|`)egolane (\w+)([^`#\n]*)", text.replace("\\\n", " "), re.M)
    }
    assert len(found) > 60
    for (name, rest), place in found.items():
        command = egolane.get_command(click.Context(egolane), name)
        assert command is not None, (name, place)
        each = command.commands.values() if isinstance(command, click.Group) else [command]
        known = {option for one in each for p in one.params for option in p.opts}
        named = set(re.findall(r"--[a-z][a-z-]*", rest))
        assert known | {"--help"} >= named, (name, rest, place)
