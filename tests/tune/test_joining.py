"""What a shared study is made of, and what a machine that joined it does for a part: no server is
needed for that."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.results import file_sha256
from egolane_pgm.tune import tuning
from egolane_pgm.tune.held_out import settings_without, without_part
from egolane_pgm.tune.joining import _find, _parts, _task
from egolane_pgm.tune.plan import Plan, Problem, evaluator, make_problem, together, with_options
from egolane_pgm.tune.postgres import Kept
from egolane_pgm.tune.space import from_unit
from egolane_pgm.types import InputError
from tests.kits.tuning_kit import BLOCKS, plan, problem


def kept(kind: str, part: int, n_parts: int) -> Kept:
    return Kept(1, "one", "job", kind, part, n_parts, 10, 30.0, {})


def two_drives() -> Plan:
    one = plan()
    [experiment] = one.experiments
    other = experiment.model_copy(
        update={
            "name": "second",
            "recording": experiment.recording.model_copy(
                update={"seed": experiment.recording.seed + 1}
            ),
        }
    )
    second = replace(one, name="second", experiments=(other,))
    return with_options(together([one, second]), {})


def some_points(found: Problem) -> list[dict[str, Any]]:
    return from_unit(found.space, np.random.default_rng(0).random((4, len(found.space))))


@pytest.mark.parametrize("part", [0, 1])
def test_without_a_recording_the_other_one_is_scored(part: int) -> None:
    found = make_problem(two_drives())
    points = some_points(found)
    task = _task(found, kept("recording", part, 2))
    evaluate = evaluator(*without_part(found, part, True))
    settings = settings_without(found, part)
    np.testing.assert_array_equal(task.evaluate(points), evaluate(points))
    assert task.settings == settings
    other = evaluator(*without_part(found, 1 - part, True))
    assert (np.asarray(task.evaluate(points)) != other(points)).any()


@pytest.mark.parametrize("n_parts", [BLOCKS, 3])
def test_blocks_are_as_many_as_the_study_was_begun_with(n_parts: int) -> None:
    found = problem()
    points = some_points(found)
    task = _task(found, kept("block", 1, n_parts))
    evaluate = evaluator(*without_part(problem(blocks=n_parts), 1, False))
    settings = settings_without(problem(blocks=n_parts), 1)
    np.testing.assert_array_equal(task.evaluate(points), evaluate(points))
    assert task.settings == settings


def test_a_larger_total_makes_the_same_studies(tmp_path: Any) -> None:
    few, many = (
        _parts(tuning.prepare(plan(trials=trials), tmp_path / f"{trials}")) for trials in (10, 20)
    )
    assert len(few) == len(many) == 1 + BLOCKS
    for one, other in zip(few, many, strict=True):
        assert (one.name, one.kind, one.part) == (other.name, other.kind, other.part)
        assert one.attributes["identity"] == other.attributes["identity"]
        assert one.attributes["code"] == other.attributes["code"]
        assert (one.settings.trials, other.settings.trials) == (10, 20)
    assert len({part.name for part in few}) == len(few)


def test_of_files_of_one_name_the_one_with_the_checksum_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in "abc":
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "lines.csv").write_text(folder)
    monkeypatch.setenv("EGOLANE_DATA", str(tmp_path))
    right = tmp_path / "b" / "lines.csv"
    sums = [file_sha256(right)[:16]]
    assert _find("/elsewhere/lines.csv", sums, "here") == right
    # Where none has it, what differs is said when the checksums are compared.
    assert _find("/elsewhere/lines.csv", ["0" * 16], "here").name == "lines.csv"
    with pytest.raises(InputError, match=r"here: other\.csv is not on this machine"):
        _find("/elsewhere/other.csv", sums, "here")
