"""How far something is, as a bar, and how long it will take, as a line that is said once."""

from __future__ import annotations

import logging
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sized
from typing import Any

if "IPython" in sys.modules:
    with warnings.catch_warnings():
        # Without ipywidgets tqdm asks for them when it is imported first, by Optuna if not here.
        warnings.simplefilter("ignore")
        import tqdm.auto  # noqa: F401

#: Is told, at INFO, how long something will take. The commands print it on standard error.
LOGGER = logging.getLogger(__name__)

#: What takes less is not announced, seconds.
_WORTH_SAYING = 10.0

#: A first item that takes so long, seconds, is not mostly what is loaded and compiled for it.
_LONG = 20.0

#: Shorter items are measured over so long, seconds.
_MEASURED = 1.0


def bar(
    items: Iterable[Any] | None = None,
    progress: bool | None = None,
    *,
    jobs: int | str = 1,
    **settings: Any,
) -> Any:
    """A bar of tqdm that says how far something is, and `LOGGER` how long it will take.

    - items: that it counts while they are taken; without them it is told by `update`.
    - progress: whether it is shown; None for in a terminal, and in a notebook that has ipywidgets.
      A bar of plain text would stay in the notebook.
    - jobs: number of processes that share the items, or a cluster.
    - settings: of tqdm. Without a total, or items that have a length, nobody knows how long it will
      take.
    """
    from tqdm import tqdm

    kind: Any = tqdm
    hidden = None if progress is None else not progress
    if "IPython" in sys.modules:
        from tqdm.autonotebook import tqdm as in_notebook

        # Without ipywidgets this is the bar of plain text.
        if in_notebook is not tqdm:
            kind, hidden = in_notebook, bool(hidden)
    if settings.get("total") is None and isinstance(items, Sized):
        settings["total"] = len(items)
    ahead = Ahead(settings.get("total") or 0, settings.get("unit", "item"), at_once(jobs))

    class Bar(kind):  # type: ignore[misc]
        def pace(self, each: float) -> None:
            """Be told what an item takes a process, seconds, before one is done."""
            ahead.say(each)

        def update(self, n: float | None = 1) -> Any:
            if items is None:
                ahead.add(int(n or 0))
            return super().update(n)

    counted = None if items is None else ahead.watch(items)
    return Bar(counted, leave=False, disable=hidden, **settings)


def at_once(jobs: int | str) -> int:
    """How many items are at work at the same time: at most so many processes as the machine has
    cores; 0 where a cluster's workers come and go."""
    if isinstance(jobs, str):
        kind, _, number = jobs.partition(":")
        jobs = int(number) if kind == "local" and number.isdecimal() else 0
    return min(jobs, os.cpu_count() or jobs)


class Ahead:
    """Says once, by its first items, how long something will take.

    - total: how many items there are.
    - unit: what one is called.
    - workers: how many are at work at the same time; 0 where nobody knows. Then nothing is said.
    - clock: tells the seconds.

    The first item of each worker does not count, because much is loaded and compiled for it; unless
    it takes so long that this is little of it.
    """

    def __init__(
        self,
        total: int,
        unit: str,
        workers: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total, self._unit, self._workers, self._clock = total, unit, workers, clock
        self._is_open = total > 1 and workers > 0
        self._begun = clock()
        self._answers = self._done = self._done_before = 0

    def watch(self, items: Iterable[Any]) -> Iterator[Any]:
        """The items; each is done when the next one is asked for."""
        self._begun = self._clock()
        for item in items:
            yield item
            self.add(1)

    def add(self, items: int) -> None:
        """Count items as done, all by one worker."""
        if not self._is_open or not items:
            return
        self._answers += 1
        self._done += items
        took = self._clock() - self._begun
        if self._answers == 1 and took >= _LONG:
            self.say(took / items)
        elif self._answers == self._workers:
            self._begun, self._done_before = self._clock(), self._done
        elif self._answers % self._workers == 0 and took >= _MEASURED:
            self.say(took * self._workers / (self._done - self._done_before))

    def say(self, each: float) -> None:
        """Say what is left, given the seconds that a worker has for an item."""
        if not self._is_open:
            return
        self._is_open = False
        left = self._total - self._done
        seconds = each * math.ceil(left / self._workers)
        if seconds >= _WORTH_SAYING:
            units = self._unit + ("es" if self._unit.endswith("ch") else "s")
            shared = f", {self._workers} at a time" if self._workers > 1 else ""
            LOGGER.info(
                "about %s to go: %s %s, %s each%s",
                _in_words(seconds), f"{left:,}", units, _short(each), shared,
            )  # fmt: skip


def _in_words(seconds: float) -> str:
    for name, size in (("day", 86400.0), ("hour", 3600.0), ("minute", 60.0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {name}s"
    return f"{seconds:.0f} seconds"


def _short(seconds: float) -> str:
    return f"{seconds * 1000:.2g} ms" if seconds < 0.1 else f"{seconds:,.{int(seconds < 10)}f} s"
