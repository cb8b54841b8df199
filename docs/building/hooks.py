"""Hooks of mkdocs: pages from outside docs/.

The site has every file that a page links to: Markdown files and notebooks (with their kept outputs)
as pages, pictures as copies, other files of text as source. So one relative link is right in the
repository and on the site. A link to the contracts of plugins leads to their page of the reference.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
import reference
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from nbconvert import MarkdownExporter

ROOT = Path(__file__).parents[2]
PICTURES = {".png", ".jpg", ".svg", ".gif"}
#: The search finds pages before sources.
LESS_SOUGHT = "---\nsearch: {boost: 0.1}\n---\n"
LINK = re.compile(r"(\]\()([^)\s#:]+)(#[^)\s]*)?(\))")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference, and the files outside docs/ that pages and the navigation name."""
    for name, content in reference.pages().items():
        files.append(File.generated(config, name, content=content))
    waiting = [ROOT / "README.md"]
    waiting += [path for f in files.documentation_pages() if (path := origin(f.src_uri)).is_file()]
    waiting += [ROOT / name for name in named(config.nav) if (ROOT / name).is_file()]
    waiting += sorted((ROOT / "notebooks").glob("*.ipynb"))
    while waiting:
        path = waiting.pop()
        uri = place(path)
        if files.get_file_from_path(uri) is None:
            for name, content in contents(path).items():
                files.append(File.generated(config, name, content=content))
        if path.suffix == ".md":
            waiting += [p for p in linked(path) if files.get_file_from_path(place(p)) is None]
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, **_: Any) -> str:
    """Turn the links of a page to the places of their files on the site."""
    path = origin(page.file.src_uri)

    def turned(found: re.Match[str]) -> str:
        before, target, anchor, after = found.groups(default="")
        goal = target_of(path, target)
        if goal is None:
            return found[0]
        link = os.path.relpath(place(goal), os.path.dirname(page.file.src_uri) or ".")
        return f"{before}{link}{anchor}{after}"

    return LINK.sub(turned, markdown)


def named(nav: Any) -> Iterator[str]:
    """The files that the navigation names."""
    if isinstance(nav, str):
        yield nav
    elif isinstance(nav, dict | list):
        for each in nav.values() if isinstance(nav, dict) else nav:
            yield from named(each)


def place(path: Path) -> str:
    """The place of a file of the repository on the site."""
    name = path.relative_to(ROOT)
    if name == Path("README.md"):
        return "index.md"
    if name == Path("egolane_pgm/contracts.py"):
        return "reference/plugins.md"
    if name.parts[0] == "docs":
        name = name.relative_to("docs")
    if path.suffix == ".ipynb":
        name = name.with_suffix(".md")
    elif path.suffix not in {".md", *PICTURES}:
        name = Path("source", f"{name}.md")
    return name.as_posix()


def origin(uri: str) -> Path:
    """The file of the repository for a page of the site."""
    inside = ROOT / "docs" / uri
    return inside if inside.exists() else ROOT / uri.replace("index.md", "README.md")


def target_of(path: Path, link: str) -> Path | None:
    """The file of the repository that a link of a file names, or None."""
    goal = Path(os.path.normpath(path.parent / link))
    return goal if goal.is_file() and goal.is_relative_to(ROOT) else None


def linked(path: Path) -> Iterator[Path]:
    """The files of the repository that a Markdown file links to."""
    for found in LINK.finditer(path.read_text()):
        goal = target_of(path, found[2])
        if goal is not None:
            yield goal


def contents(path: Path) -> dict[str, str | bytes]:
    """The content of the site for a file, by place; a notebook has its pictures, too."""
    if path.suffix == ".ipynb":
        return notebook(path)
    if path.suffix == ".md":
        return {place(path): path.read_text()}
    if path.suffix in PICTURES:
        return {place(path): path.read_bytes()}
    language = path.suffix.lstrip(".").replace("cff", "yaml")
    name = path.relative_to(ROOT)
    return {place(path): f"{LESS_SOUGHT}# {name}\n\n````{language}\n{path.read_text()}\n````\n"}


def notebook(path: Path) -> dict[str, str | bytes]:
    """A notebook with its kept outputs, as Markdown, and its pictures."""
    body, resources = MarkdownExporter().from_notebook_node(nbformat.read(path, as_version=4))
    folder, page = Path(place(path)).parent, Path(place(path))
    pictures = resources["outputs"]
    for name in pictures:
        body = body.replace(f"]({name})", f"]({page.stem}_{name})")
    # Tables by pandas look like those of the site, and wide ones scroll.
    body = re.sub(r"<style scoped>.*?</style>", "", body, flags=re.S)
    body = re.sub(r'<table border="1" class="dataframe">', "<table>", body)
    named_so = {
        (folder / f"{page.stem}_{name}").as_posix(): data for name, data in pictures.items()
    }
    return {page.as_posix(): body, **named_so}
