"""`egolane online`: messages on standard input, answers on standard output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.kits.drives import command, refused, run, short_drive, write_drive
from tests.kits.streams import messages

N_FRAMES = 60


def answers(*words: object, given: str | None = None) -> list[dict[str, Any]]:
    """What `egolane online` answers to the messages of the short drive."""
    sent = "\n".join(messages(short_drive(N_FRAMES).log)) + "\n" if given is None else given
    ran = command("online", *words, given=sent)
    assert ran.exit_code == 0, ran.output
    return [json.loads(line) for line in ran.stdout.splitlines()]


def test_the_answers_are_those_of_a_run(tmp_path: Path) -> None:
    path = write_drive(tmp_path, N_FRAMES, filter="fixed_lag", lag=5)
    found = answers(path, "--node", "SensorState", "--node", "Lane")
    frames = run(path).frames
    assert [answer["lane"] for answer in found] == frames["assigned_lane"].to_list()
    assert set(found[0]["beliefs"]) == {"SensorState", "Lane"}
    beliefs = [answer["beliefs"]["SensorState"]["OK"] for answer in found]
    np.testing.assert_allclose(beliefs, frames["SensorState_OK"], atol=1e-12)


def test_other_names_of_fields_are_an_option(tmp_path: Path) -> None:
    path = write_drive(tmp_path, N_FRAMES)
    message = {"t": 0.1, "lanes": [{"c0": 1.8}, {"c0": -1.7}]}
    words = ("--columns", "time_s=t,offset_m=c0,left_positive=true")
    [answer] = answers(path, *words, given=json.dumps(message))
    usual = {"time_s": 0.1, "lines": [{"offset_m": -1.8}, {"offset_m": 1.7}]}
    assert [answer] == answers(path, given=json.dumps(usual))


@pytest.mark.parametrize(
    ("words", "sent", "message"),
    [
        ("", "{", "message 1: is not JSON"),
        ("--node Lanes", '{"frame_id": 1, "lines": []}', "--node: 'Lanes' is not one of Lane,"),
        ("--columns ofset_m=y", "", "columns: unknown key 'ofset_m' (did you mean 'offset_m'?)"),
    ],
)
def test_messages_and_options_that_do_not_fit_are_refused_in_one_line(
    tmp_path: Path, words: str, sent: str, message: str
) -> None:
    path = write_drive(tmp_path, N_FRAMES)
    assert message in refused("online", path, *words.split(), given=sent)
