"""The energy of the conditional random field beside a plain version, and how far the authors'
inference is from the least energy."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from egolane_pgm.classic.multilane import crf
from egolane_pgm.classic.multilane.crf import Links
from egolane_pgm.classic.multilane.markings import Markings, grouped
from egolane_pgm.classic.multilane.road import road_of
from egolane_pgm.types import BoolArray, FloatArray, IntArray
from egolane_pgm.vision.camera.model import Camera

#: As the authors' pictures are.
ROAD = road_of(
    Camera(1280, 720, 1065.0, 1065.0, 639.5, 359.5, height_m=1.65, pitch_deg=-6.6),
    55.0,
    0.078,
    0.3,
)

N_GROUPS, MOST_LINKS = 1000, 10

#: Of 1,000 groups: the mean and the largest gap of energy, the share solved exactly.
MEAN, WORST, EXACT = 0.04, 3.6, 0.93


def markings_of(points: list[FloatArray]) -> Markings:
    """Seeds of given points (row, column)."""
    row, u = np.concatenate(points).T
    seed = np.repeat(np.arange(len(points)), [len(p) for p in points])
    return grouped(row, u - 5, u + 5, seed)


def scattered(rng: np.random.Generator) -> Markings:
    """Pieces of two or three lines that nearly meet, with gaps, steps and noise, and strays."""
    points = []
    for _ in range(rng.integers(2, 4)):
        place, slope, bend = rng.uniform(500, 700), rng.uniform(-1, 1), rng.uniform(-60, 60)
        row = rng.uniform(270, 330)
        while row < 640:
            rows = np.arange(row, row + rng.integers(6, 40))
            t = (rows - 450) / 200
            step = rng.normal(0, 12)
            points.append(
                np.stack([rows, place + step + slope * (rows - 450) + bend * t * t], axis=1).round(
                    1
                )
            )
            row = rows[-1] + rng.integers(10, 90)
    return markings_of([p + rng.normal(0, [0, 0.7], p.shape) for p in points])


def quality_by_numpy(row: FloatArray, u: FloatArray) -> float:
    middle = row.mean()
    t = (row - middle) / 200
    rest = u - np.polyval(np.polyfit(t, u, 3), t)
    return float(np.exp(-(((rest @ rest) / len(u) / crf.SPREAD) ** 2)))


def energy_by_numpy(
    is_on: BoolArray, above: IntArray, below: IntArray, probability: FloatArray, seeds: Markings
) -> float:
    """From the markings, chain by chain."""
    if len(set(above[is_on])) < is_on.sum() or len(set(below[is_on])) < is_on.sum():
        return np.inf
    total = -float(probability[is_on].sum() + (1 - probability[~is_on]).sum())
    if not is_on.any():
        return total - 0.5
    down = dict(zip(above[is_on].tolist(), below[is_on].tolist(), strict=True))
    worst = 1.0
    for head in down.keys() - set(down.values()):
        chain = [head]
        while chain[-1] in down:
            chain.append(down[chain[-1]])
        inside = np.isin(seeds.seed, chain)
        worst = min(worst, quality_by_numpy(seeds.row[inside], seeds.u[inside]))
    return total - worst if worst >= 0.5 else np.inf


def groups(count: int, seed: int) -> list[tuple[Links, FloatArray, FloatArray, Markings]]:
    """Groups of at most MOST_LINKS links: the links, their probabilities, sums and markings."""
    rng = np.random.default_rng(seed)
    found: list[tuple[Links, FloatArray, FloatArray, Markings]] = []
    while len(found) < count:
        seeds = scattered(rng)
        links = crf.candidate_links(seeds, ROAD)
        probability, sums = crf.unary(links, 1.0), crf.power_sums(seeds, 1.0)
        for which in crf.groups_of(links, len(seeds)):
            if 2 <= len(which) <= MOST_LINKS:
                some = Links(
                    links.above[which], links.below[which], links.apart[which], links.turn[which]
                )
                found.append((some, probability[which], sums, seeds))
    return found[:count]


@pytest.fixture(scope="module")
def given_groups() -> list[tuple[Links, FloatArray, FloatArray, Markings]]:
    return groups(N_GROUPS, seed=1)


def test_the_energy_equals_the_one_from_all_markings(
    given_groups: list[tuple[Links, FloatArray, FloatArray, Markings]],
) -> None:
    rng = np.random.default_rng(0)
    n_finite = 0
    for links, probability, sums, seeds in given_groups[:200]:
        for _ in range(10):
            is_on = rng.random(len(links)) < 0.3
            given = is_on, links.above, links.below, probability
            plain = energy_by_numpy(*given, seeds)
            assert crf.energy(*given, sums) == pytest.approx(plain, abs=1e-3)
            n_finite += np.isfinite(plain) and is_on.any()
    assert n_finite > 200


def test_the_exact_inference_is_brute_force_and_the_authors_one_is_near(
    given_groups: list[tuple[Links, FloatArray, FloatArray, Markings]],
) -> None:
    """`-s` prints how far the published inference is from the least energy."""
    gaps = []
    for links, probability, sums, _ in given_groups:
        given = links.above, links.below, probability, sums
        least = min(
            crf.energy(np.array(on), *given) for on in product([False, True], repeat=len(links))
        )
        assert crf.energy(crf.least_energy(*given), *given) == least
        gaps.append(crf.energy(crf.forced_in_turn(*given), *given) - least)
    gap = np.array(gaps)
    sizes = np.bincount([len(links) for links, *_ in given_groups])
    print(
        f"\n{len(gap)} groups of 2 to {MOST_LINKS} links ({sizes[2:].tolist()} of each size):"
        f" energy gap mean {gap.mean():.4f}, worst {gap.max():.3f},"
        f" exact in {(gap < 1e-9).mean():.1%}"
    )
    assert (gap >= 0).all()
    assert gap.mean() <= MEAN
    assert gap.max() <= WORST
    assert (gap < 1e-9).mean() >= EXACT


def line(rows: FloatArray, place: float, slope: float) -> FloatArray:
    return np.stack([rows, place + slope * (rows - 450)], axis=1)


def test_dashes_of_one_line_are_joined_and_dashes_of_two_are_not() -> None:
    dashes = [np.arange(first, first + 25.0) for first in (290, 370, 470, 600)]
    seeds = markings_of(
        [line(rows, place, slope) for place, slope in ((500, -1.2), (900, 1.3)) for rows in dashes]
    )
    for exact_up_to in (0, 10):
        joined = crf.join_seeds(seeds, ROAD, exact_up_to)
        assert np.diff(joined.starts).tolist() == [100, 100]
        assert np.ptp(joined.u[:100] + 1.2 * joined.row[:100]) < 1e-6


def test_a_link_is_merged_by_its_own_label() -> None:
    """The published code reads another one's."""
    rows = [np.arange(first, first + 25.0) for first in (290, 370, 470)]
    seeds = markings_of([line(r, 640, 0.0) for r in rows])
    both = np.array([0, 1], dtype=np.int64)
    links = Links(both, both + 1, np.zeros((2, 2)), np.zeros(2))
    for label, lengths in (([True, False], [50, 25]), ([False, True], [25, 50])):
        joined = crf.merged(seeds, links, np.array(label))
        assert np.diff(joined.starts).tolist() == lengths
