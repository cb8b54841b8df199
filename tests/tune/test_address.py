"""Addresses of storages as users mistype them: no password is ever shown. No server is needed."""

from __future__ import annotations

from pathlib import Path

import pytest

from egolane_pgm.tune.address import MASK, parse, without_passwords
from tests.kits.drives import refused


@pytest.mark.parametrize("key", ["sslpassword", "passwd", "PASSWORD"])
def test_an_option_of_the_address_that_is_a_password_is_not_shown(key: str) -> None:
    address = parse(f"postgresql://u@host/base?{key}=hun%2Fter2&passfile=/a/b&sslmode=require")
    assert address.parameters[key] == "hun/ter2"
    # As it was typed is how SQLAlchemy shows it, too.
    assert address.shown.startswith("postgresql+psycopg://u@host/base?")
    assert "passfile=" in address.shown
    assert "sslmode=require" in address.shown
    assert "ter2" not in repr(address)
    assert address.hide("hun/ter2 hun%2Fter2 /a/b") == f"{MASK} {MASK} /a/b"


@pytest.mark.parametrize(
    "words",
    [
        ("studies", "URL"),
        ("tune", "x.yaml", "--trials", "URL"),
        ("tune", "URL"),
        ("run", "URL"),
        ("tune", "x.yaml", "--out", "URL/x"),
    ],
)
def test_an_address_in_the_wrong_place_is_not_shown_with_its_password(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for url in ("postgresql://u:hunt@er2@host/base", "postgresql://u@host/base?password=hunter2"):
        line = refused(*(word.replace("URL", url) for word in words))
        assert "er2" not in line
    assert not list(tmp_path.iterdir())


def test_texts_without_an_address_are_left_as_they_are() -> None:
    for text in ("lanes: 3 @ 10 Hz", "https://host/a?pass=", "C:/a/b", "see https://x.org/a@b"):
        assert without_passwords(text) == text.replace("pass=", f"pass={MASK}")
