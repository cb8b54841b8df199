"""The documentation site builds without a warning, and its pages load nothing from a network."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

#: Attributes that make a browser load something; a link (`a`) waits for a click.
LOADING = {"src", "srcset", "data", "poster", "action", "href"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built with warnings as errors."""
    folder = tmp_path_factory.mktemp("site")
    ran = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr
    return folder


class Loads(HTMLParser):
    """The addresses that a browser loads with a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "a" or ("rel", "canonical") in attrs:
            return
        self.found += [value for name, value in attrs if name in LOADING and value]


def loaded(page: str) -> list[str]:
    parser = Loads()
    parser.feed(page)
    return [address for address in parser.found if re.match(r"(https?:)?//", address)]


def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    found = {page.name: loaded(page.read_text()) for page in pages}
    assert not {name: addresses for name, addresses in found.items() if addresses}
    for style in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", style.read_text()), style
    for page in pages:
        # The theme would fetch a drawing program for these.
        assert 'class="mermaid"' not in page.read_text(), page


def test_notebooks_are_shown_with_their_outputs_and_the_files_that_pages_name(site: Path) -> None:
    page = (site / "notebooks" / "01_quickstart.html").read_text()
    pictures = re.findall(r'src="(01_quickstart_[^"]*\.png)"', page)
    assert pictures
    assert all((site / "notebooks" / name).stat().st_size > 1000 for name in pictures)
    assert (site / "results" / "paper" / "strips.png").is_file()
    assert (site / "source" / "egolane_pgm" / "maps" / "lane_graph.py.html").is_file()


def test_the_search_finds_pages_before_sources(site: Path) -> None:
    found = json.loads((site / "search" / "search_index.json").read_text())["docs"]
    boosts = {each["location"].startswith("source/"): each.get("boost", 1) for each in found}
    assert boosts == {False: 1, True: 0.1}
