"""Error messages are one line of bounded length."""

from __future__ import annotations

import pickle

from lsnet import LSNetError


def test_short_messages_stay_as_they_are() -> None:
    assert str(LSNetError("photo.jpg: cannot be read")) == "photo.jpg: cannot be read"


def test_long_messages_keep_their_beginning_and_end_on_one_line() -> None:
    text = str(LSNetError("photo" + "\n" * 1_000_000 + "cannot be read"))
    assert text.startswith("photo ")
    assert text.endswith("cannot be read")
    assert "\n" not in text
    assert len(text) < 1000


def test_errors_cross_process_borders() -> None:
    error = LSNetError("x" * 5000)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)  # noqa: S301
