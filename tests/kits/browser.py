"""A real Chromium, where there is one, and a page opened in it from its file."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

#: The names of a Chromium of the system; without one, playwright's own is tried.
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@dataclass
class Opened:
    """A page, and what went wrong in it: errors, and addresses that it asked for."""

    page: Any
    errors: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def range(self) -> tuple[float, float]:
        """The range of the timeline, seconds."""
        found = self.page.evaluate(
            "() => { const time = Bokeh.documents[0].get_model_by_name('time');"
            " return [time.start, time.end] }"
        )
        return float(found[0]), float(found[1])


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """A browser. The test is skipped, saying so, where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="pages: needs playwright")
    found = next((place for name in NAMES if (place := shutil.which(name))), None)
    with api.sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        except api.Error as error:
            pytest.skip(f"pages: no Chromium runs here ({str(error).splitlines()[0]})")
        yield browser
        browser.close()


def opened(browser: Any, file: Path, width: int = 1200, **options: Any) -> Opened:
    """A page opened from its file, drawn. options: of the browser's context."""
    context = browser.new_context(viewport={"width": width, "height": 900}, **options)
    found = Opened(context.new_page())
    page = found.page
    page.on("pageerror", lambda error: found.errors.append(str(error)))
    page.on("dialog", lambda dialog: (found.errors.append(dialog.message), dialog.dismiss()))
    page.on(
        "console",
        lambda said: said.type in ("error", "warning") and found.errors.append(said.text),
    )
    page.on(
        "request",
        lambda request: (
            request.url.startswith(("data:", "blob:")) or found.asked.append(request.url)
        ),
    )
    page.goto(file.absolute().as_uri())
    page.wait_for_function("window.Bokeh?.documents[0]?.is_idle", timeout=60_000)
    return found
