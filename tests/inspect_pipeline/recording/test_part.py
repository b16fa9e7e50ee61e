"""Several recordings in one file, and messages after the end of a recording."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest
from factories import CAMERA, START_NS, STEP_NS, make_recording, number_of, shots
from fakes import FakeDetector
from mcap.reader import make_reader

from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.pipeline import process
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

DATA_END = struct.pack("<BQI", 15, 4, 0)


def two(folder: Path) -> tuple[bytes, bytes]:
    """Return recordings of the pictures 0 to 3 and 4 to 7, which number their channels differently."""
    first = make_recording(folder / "1.mcap", shots(4))
    later = [shot for topic in ("/a/other", CAMERA) for shot in shots(8, topic)[4:]]
    second = make_recording(folder / "2.mcap", later)
    return first.read_bytes(), second.read_bytes()


@pytest.mark.parametrize("between", [b"", b"\0" * 1000])
def test_concatenated_recordings_are_read_as_one(tmp_path: Path, between: bytes) -> None:
    first, second = two(tmp_path)
    path = tmp_path / "cat.mcap"
    path.write_bytes(first + between + second)
    recording = open_recording(path)
    assert [(part.start, part.file_bytes) for part in recording.parts] == [
        (0, len(path.read_bytes())),
        (len(first + between), len(path.read_bytes())),
    ]
    assert recording.losses == ()
    frames = iter_frames(recording, recording.select_cameras([CAMERA]))
    assert [(f.frame_idx, number_of(f.image)) for f in frames] == [(i, i) for i in range(8)]
    assert frames.losses == ()


def test_the_copy_of_concatenated_recordings_is_one_recording(tmp_path: Path) -> None:
    path, store = tmp_path / "cat.mcap", Store(tmp_path / "store")
    path.write_bytes(b"".join(two(tmp_path)))
    detector, options = FakeDetector(), ProcessOptions(topics=(CAMERA,))
    result = process(path, store, detector, options, start_run(detector, options))
    assert (result.status, result.n_frames) == ("ok", 8)
    with result.annotated.open("rb") as file:  # the plain reader
        messages = make_reader(file, validate_crcs=True).iter_messages(
            [CAMERA, f"{CAMERA}/lsnet/annotations"]
        )
        times = [message.log_time for *_, message in messages]
    assert times == sorted(2 * [START_NS + i * STEP_NS for i in range(8)])


def test_a_recording_after_a_truncated_one_is_read(tmp_path: Path) -> None:
    """A recorder that was interrupted, and appended to the same file when it started again."""
    first, second = two(tmp_path)
    path = tmp_path / "a.mcap"
    end = open_recording(tmp_path / "1.mcap").parts[0].layout.data_end
    path.write_bytes(first[:end] + second)
    recording = open_recording(path)
    assert recording.losses == ("the file has no end, as when a recorder is interrupted",)
    frames = iter_frames(recording, recording.select_cameras([CAMERA]))
    assert [number_of(f.image) for f in frames] == list(range(8))


def test_bytes_after_the_end_are_reported(tmp_path: Path) -> None:
    first, _ = two(tmp_path)
    path = tmp_path / "a.mcap"
    path.write_bytes(first + b"\0" * 100)
    assert open_recording(path).losses == ()
    path.write_bytes(first + b"\0" * 100 + b"notes")
    assert open_recording(path).losses == ("5 bytes after its end are not part of a recording",)


@pytest.mark.parametrize("chunked", [False, True])
def test_messages_after_a_data_end_are_read(tmp_path: Path, chunked: bool) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(40), use_chunking=chunked)
    layout = open_recording(path).parts[0].layout
    content = path.read_bytes()
    at = layout.extents[1].offset if chunked else layout.extents[0].offset + 600
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0) + content[-8:]
    if not chunked:
        at = next(
            o
            for o in range(at, at + 2000)
            if content[o : o + 1] == b"\5" and content[o + 2 : o + 9] == bytes(7)
        )
    path.write_bytes(content[:at] + DATA_END + content[at : layout.data_end] + DATA_END + footer)
    recording = open_recording(path)
    assert recording.losses == ("a Data End record comes before the last messages",)
    assert [number_of(frame.image) for frame in iter_frames(recording)] == list(range(40))

    store, detector, options = Store(tmp_path / "store"), FakeDetector(), ProcessOptions()
    result = process(path, store, detector, options, start_run(detector, options))
    assert (result.status, result.n_frames) == ("recovered", 40)
    with result.annotated.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages([CAMERA]))) == 40
