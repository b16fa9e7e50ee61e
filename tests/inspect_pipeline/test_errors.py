from __future__ import annotations

import pickle
from pathlib import Path

from inspect_pipeline.errors import MAX_MESSAGE, DamagedRecordingError, RecordingError


def test_a_message_stays_readable_whatever_names_a_file_holds() -> None:
    error = RecordingError(Path("a.mcap"), f"no images on topic /{'x' * 1_000_000}", "its topics: none")
    assert len(str(error)) == MAX_MESSAGE
    assert str(error).startswith("a.mcap: no images on topic /xxx")
    assert str(error).endswith("xxx; its topics: none")
    assert str(RecordingError(Path("a\nb"), "bad", "copy it")) == "a?b: bad; copy it"


def test_errors_survive_processes() -> None:
    error = pickle.loads(pickle.dumps(DamagedRecordingError(Path("a.mcap"), "it is cut")))  # noqa: S301
    assert (type(error), str(error), error.problem) == (
        DamagedRecordingError,
        "a.mcap: it is cut; copy it again, or process the part that can be read",
        "it is cut",
    )
