"""Recordings that are damaged or none: refused in one line, or read as far as they are whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import factories
import pytest
from factories import CAMERA, make_recording, number_of, shots
from writers import WRITERS, numbers

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "it is empty"),
        (b"hello, this is text", "it is not an MCAP file"),
        (b"\x89MCAP0\r\n", "the file is cut off"),
        (b"\x89MCAP0\r\n\x01" + b"\xff" * 40, "the file is cut off"),
    ],
)
def test_other_files_are_refused_in_one_line(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    assert caught.value.problem == problem
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_file_and_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no such file"):
        open_recording(tmp_path / "missing.mcap")
    with pytest.raises(RecordingError, match="the folder has no recording; make one of photographs"):
        open_recording(tmp_path)


def test_no_camera_topic_is_refused_at_the_call(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "a.mcap", [])
    with pytest.raises(RecordingError, match="no camera topic"):
        iter_frames(open_recording(path))
    path = make_recording(tmp_path / "b.mcap", shots(2))
    with pytest.raises(RecordingError, match=f"its image topics: {CAMERA}"):
        open_recording(path).select_cameras(["/thermal"])


def test_the_error_says_why_images_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("inspect_pipeline.images.decode.can_decode", lambda: False)
    video = [shot._replace(data=b"\0\0\0\1\x67 h264") for shot in shots(2)]
    path = make_recording(tmp_path / "a.mcap", video)
    assert open_recording(path).refusals == {CAMERA: "it holds video, which needs the extra 'video'"}
    with pytest.raises(RecordingError, match=f"no camera topic; {CAMERA}: it holds video"):
        iter_frames(open_recording(path))
    how = factories.ENCODINGS["json"]
    unknown = factories.Encoding("other.CompressedVideo", "jsonschema", b"{}", "json", how.encode)
    path = make_recording(tmp_path / "b.mcap", shots(2), encoding=unknown)
    with pytest.raises(RecordingError, match=r"other\.CompressedVideo in json is not read"):
        iter_frames(open_recording(path))


@pytest.mark.parametrize("name", ["mcap", "unchunked", "unindexed", "mcap lz4"])
def test_a_truncated_file_is_read_up_to_the_cut(tmp_path: Path, name: str) -> None:
    whole = make_recording(tmp_path / "whole.mcap", shots(12), **WRITERS[name]).read_bytes()
    path = tmp_path / "cut.mcap"
    n_frames = []
    for length in range(200, len(whole), 97):
        path.write_bytes(whole[:length])
        recording = open_recording(path)
        frames = list(iter_frames(recording)) if recording.camera_channels else []
        assert [number_of(f.image) for f in frames] == list(range(len(frames)))
        assert len(recording.losses) == 1
        n_frames.append(len(frames))
        with pytest.raises(RecordingError, match="the part that can be read"):
            open_recording(path, strict=True)
    assert n_frames == sorted(n_frames)
    assert n_frames[-1] == 12


def test_a_damaged_chunk_is_lost_and_the_rest_is_read(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(20), n_gps_per_shot=0)
    recording = open_recording(path)
    extent = recording.parts[0].layout.extents[2]
    content = bytearray(path.read_bytes())
    content[extent.offset + extent.length - 100] ^= 0x10
    path.write_bytes(content)
    frames = iter_frames(recording)
    assert 0 < len(list(frames)) < 20
    assert len(frames.losses) == 1
    assert f"at byte {extent.offset:,}" in frames.losses[0]
    assert recording.losses == ()
    with pytest.raises(RecordingError, match="the part that can be read"):
        list(iter_frames(open_recording(path, strict=True)))


def test_a_wrong_summary_is_ignored(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(20), enable_crcs=False)
    content = bytearray(path.read_bytes())
    offset = open_recording(path).parts[0].layout.extents[1].offset
    at = content.rindex(offset.to_bytes(8, "little"))
    content[at : at + 8] = (offset + 1).to_bytes(8, "little")
    path.write_bytes(content)
    assert numbers(path) == [(CAMERA, i, i) for i in range(20)]
    assert len(open_recording(path).losses) == 1


def test_unknown_compression_is_refused(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(5), enable_crcs=False)
    path.write_bytes(path.read_bytes().replace(b"zstd", b"zst9"))
    with pytest.raises(RecordingError, match="zst9"):
        list(iter_frames(open_recording(path)))
