"""What a worker of a shared study tries next, from the trials that it knows of.

Each worker keeps a copy of the study in memory, fed with what the others finished.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from egolane_pgm.tune.space import Point, SearchSpace, distributions
from egolane_pgm.tune.study import BATCHED, Proposals, Settings, make_sampler, new_study

if TYPE_CHECKING:
    from optuna.trial import Trial

    from egolane_pgm.tune._claims import Told


@dataclass(frozen=True)
class Offer:
    """A point to try. attrs: what its sampler notes about it. retry_of: the number of the trial
    that was lost."""

    point: Point
    attrs: Mapping[str, Any] | None = None
    retry_of: int | None = None


class Proposer(Protocol):
    """Proposes points."""

    def learn(self, trials: Sequence[Told]) -> None:
        """Take finished trials into account."""
        ...

    def prepare(self) -> None:
        """Do beforehand what takes long: an offer is made while everybody waits."""
        ...

    def offer(self, number: int, at_most: int) -> list[Offer]:
        """What the trials from this number on are to be; may be asked again."""
        ...

    def taken(self, points: Sequence[Point]) -> None:
        """Points that were claimed in the end."""
        ...


def make_proposer(
    space: SearchSpace, settings: Settings, starts: Sequence[Point], entropy: int
) -> Proposer:
    """The proposer of a sampler. entropy: another one for each worker."""
    if settings.sampler in BATCHED:
        return _Batched(space, settings, starts)
    return _OneByOne(space, settings, starts, entropy)


class _Batched:
    """A sampler of our own: points are known from their numbers."""

    def __init__(self, space: SearchSpace, settings: Settings, starts: Sequence[Point]) -> None:
        self.proposals = Proposals(space, settings, starts)
        self.heard: list[Told] = []

    def learn(self, trials: Sequence[Told]) -> None:
        self.heard += trials

    def prepare(self) -> None:
        pass

    def offer(self, number: int, at_most: int) -> list[Offer]:
        if self.heard:
            # In the order of their numbers: a generation ends with the first trial of the next.
            # Number, params and values are all that is read of a trial.
            heard: Any = sorted(self.heard, key=lambda told: told.number)
            self.proposals.learn(heard)
            self.heard = []
        self.proposals.advance_to(number)
        return [Offer(point) for point in self.proposals.points(number, at_most)]

    def taken(self, points: Sequence[Point]) -> None:
        pass


class _OneByOne:
    """A sampler of Optuna."""

    def __init__(
        self, space: SearchSpace, settings: Settings, starts: Sequence[Point], entropy: int
    ) -> None:
        self.ranges = distributions(space)
        self.starts = starts
        self.study = new_study(settings)
        self.study.sampler = make_sampler(settings, entropy)
        self.next: Trial | None = None
        self.asked: list[Trial] = []
        self.known: set[int] = set()

    def learn(self, trials: Sequence[Told]) -> None:
        from optuna.trial import create_trial

        for told in trials:
            if told.number in self.known:
                continue
            self.known.add(told.number)
            own = [t for t in self.asked if t.params == told.params]
            if own and told.attrs is None:
                self.asked.remove(own[0])
                self.study.tell(own[0], list(told.values))
                continue
            self.study.add_trial(
                create_trial(
                    params=dict(told.params),
                    distributions=self.ranges,
                    values=list(told.values),
                    system_attrs=dict(told.attrs or {}),
                )
            )

    def prepare(self) -> None:
        if self.next is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.next = self.study.ask(self.ranges)

    def offer(self, number: int, at_most: int) -> list[Offer]:
        if number < len(self.starts):
            return [Offer(self.starts[number])]
        assert self.next is not None
        frozen = self.study.get_trials(deepcopy=False)[self.next.number]
        return [Offer(dict(self.next.params), dict(frozen.system_attrs))]

    def taken(self, points: Sequence[Point]) -> None:
        if self.next is not None and self.next.params in [dict(p) for p in points]:
            self.asked.append(self.next)
            self.next = None
