"""The tables and the figure of searches, on two short simulated drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from makers.tuned import measured, shown

QUICKSTART = ego.experiments_folder() / "quickstart.yaml"
DRIVE = "{{include: {quickstart}, name: {name}, recording: {{simulate: quickstart, seed: {seed}}}}}"


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    names = "run01_italy_ml", "run02_italy_sl"
    made = [tmp_path / f"{name}.yaml" for name in names]
    for seed, (name, file) in enumerate(zip(names, made, strict=True)):
        file.write_text(DRIVE.format(quickstart=QUICKSTART, name=name, seed=seed))
    both = tmp_path / "all_italy.yaml"
    members = ", ".join(file.name for file in made)
    both.write_text(f"{{name: all_italy, experiments: [{members}], tuning: {{blocks: 7}}}}")
    return [*made, both]


def test_the_searches_are_scored_on_frames_and_drives_that_they_have_not_seen(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measured, "values_of", lambda bounds: [bounds.low, bounds.high])
    found, on = measured.measure(files, 2, 4, 2, tmp_path / "studies", 1)
    first, second, both = found
    # As `egolane tune` scores the same search.
    scratch = {"tuning.from_scratch": True}
    study = ego.tune(str(files[0]), trials=4, overrides=scratch).studies[0].study
    assert first.seen[0] == pytest.approx(study["best"]["values"]["accuracy"])
    assert first.held[0] == pytest.approx(study["held_out"]["all_frames"]["accuracy"])
    # Another recording is scored whole.
    alone = [ego.objective(files[1])(point) for point in first.points]
    assert first.on["run02_italy_sl"] == pytest.approx(np.mean(alone))
    assert both.seen[1] == pytest.approx(
        np.mean([ego.objective(file)(both.points[1]) for file in files[:2]])
    )
    assert set(both.held_on) == set(on) == {first.name, second.name}
    text = "\n".join(shown.page(found, on))
    assert text.count("| A4, all") == 3
    assert f"{first.held.mean():.3f}" in text
    shown.draw(found, on, tmp_path / "tuned.png")
    assert (tmp_path / "tuned.png").stat().st_size > 50_000


def test_a_parameter_that_the_frames_tell_is_held_by_them_and_another_is_not(
    files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measured, "values_of", lambda bounds: [bounds.low, bounds.high])
    start = ego.load_experiment(files[0]).parameters
    found = measured.told([str(files[0])], [start], 2)
    held, anew = found["sigma1"]
    assert held.low == start["sigma1"] == held.high
    assert held.share == 0
    assert anew.share >= held.share
