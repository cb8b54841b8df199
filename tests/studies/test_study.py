"""Searches from end to end: what they say of themselves, and that they go on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from egolane_pgm.tuning import study as studies
from egolane_pgm.tuning.plan import Plan, with_options
from egolane_pgm.tuning.study import Search, prepare
from egolane_pgm.tuning.task import task_of
from tests.kits.tuning_kit import plan

from egolane_pgm.types import InputError


@pytest.fixture
def searched() -> Plan:
    return plan(trials=35, never_fit=((1100, None),))


def tuned(made: Search, **options: Any) -> dict[str, Any]:
    [document] = studies.tune([made], **options)
    return document


def test_a_study_reports_in_sample_and_held_out_and_marks_them(
    searched: Plan, tmp_path: Path
) -> None:
    document = tuned(prepare(searched, tmp_path))
    assert document["in_sample"]["tuned_on"] == "same_frames"
    assert document["held_out"]["tuned_on"] == "other_frames"
    [(score, best)] = document["best"]["values"].items()
    assert document["in_sample"]["all_frames"][score] == pytest.approx(best)
    subsets = document["in_sample"].keys() - {"tuned_on"}
    assert "without_never_fit" in subsets
    for subset in subsets:
        inside, outside = document["in_sample"][subset], document["held_out"][subset]
        lost = document["difference"][subset][score]
        assert lost == pytest.approx(inside[score] - outside[score])
        low, high = inside["intervals"][score] or (0, 1)
        assert low <= inside[score] <= high
    scored = [document["held_out"][k]["frames_scored"] for k in sorted(subsets)]
    assert scored == sorted(set(scored), reverse=True)


def test_processes_find_the_same_as_one(searched: Plan, tmp_path: Path) -> None:
    one, two = (tuned(prepare(searched, tmp_path / str(jobs)), jobs=jobs) for jobs in (1, 2))
    for key in ("in_sample", "held_out", "difference"):
        assert one[key] == two[key]
    assert one["best"]["point"] == two["best"]["point"]


def test_workers_share_a_study_and_one_process_may_go_on_with_it(
    searched: Plan, tmp_path: Path
) -> None:
    many = prepare(with_options(searched, {"trials": 20}), tmp_path, "none")
    more = prepare(with_options(searched, {"trials": 24}), tmp_path, "none")
    # Each worker finishes what it is at when the total is reached.
    assert 20 <= tuned(many, workers=2)["best"]["trials"] <= 21
    assert tuned(more)["best"]["trials"] == 24


def test_nested_studies_that_are_done_are_not_run_again(
    searched: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = []
    original, last = studies.search_without, searched.tuning.blocks - 1

    def counted(space: Any, score: Any, settings: Any, part: int, **options: Any) -> Any:
        ran.append(part)
        if part == last and ran.count(last) == 1:
            raise KeyboardInterrupt
        return original(space, score, settings, part, **options)

    monkeypatch.setattr(studies, "search_without", counted)
    with pytest.raises(KeyboardInterrupt):
        tuned(prepare(searched, tmp_path))
    tuned(prepare(searched, tmp_path))
    assert ran == [*range(last + 1), last]


def test_another_search_in_the_same_place_is_refused_and_nothing_changed(
    searched: Plan, tmp_path: Path
) -> None:
    tuned(prepare(searched, tmp_path, "none"))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    key = task_of(searched, "none").space.keys[-1]
    for options, said in (
        ({"seed": 5}, "seed: 0, now 5"),
        ({"parameters": {key: [0.1, 0.2]}}, key),
    ):
        with pytest.raises(InputError, match="holds another study of this name") as caught:
            prepare(with_options(searched, options), tmp_path, "none")
        assert said in str(caught.value)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
