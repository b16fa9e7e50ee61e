from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from factories import START_NS, STEP_NS, encoded_picture, number_of
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from pathlib import Path


def test_a_new_recording_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    with new_recording(path) as author:
        author.write_calibration(
            "/camera/calibration",
            START_NS,
            "camera",
            image_size=(12, 16),
            focal_px=(20.0, 21.0),
            centre_px=(8.0, 6.0),
        )
        for i in range(5):
            time_ns = START_NS + i * STEP_NS
            author.write_location(
                "/gps/fix", time_ns, "gps", latitude_deg=47.5, longitude_deg=8.25 + i, altitude_m=500.0
            )
            author.write_image("/camera/image/compressed", time_ns, "camera", encoded_picture(i), "png")
        author.add_metadata("simulation", {"seed": "3"})

    recording = open_recording(path, strict=True)
    assert [number_of(frame.image) for frame in iter_frames(recording)] == list(range(5))
    assert recording.metadata == {"simulation": {"seed": "3"}}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        messages = list(reader.iter_decoded_messages())
    (calibration,) = (m.decoded_message for m in messages if m.channel.topic == "/camera/calibration")
    assert list(calibration.K) == [20, 0, 7.5, 0, 21, 5.5, 0, 0, 1]
    assert (calibration.height, calibration.width) == (12, 16)
    fixes = [m for m in messages if m.channel.topic == "/gps/fix"]
    assert [m.decoded_message.longitude for m in fixes] == [8.25 + i for i in range(5)]
    assert all(m.decoded_message.timestamp.ToNanoseconds() == m.message.log_time for m in fixes)
    assert {m.schema.name for m in messages} == {
        "foxglove.CameraCalibration",
        "foxglove.CompressedImage",
        "foxglove.LocationFix",
    }


def test_a_recording_appears_complete_and_replaces_none(tmp_path: Path) -> None:
    path = tmp_path / "new.mcap"
    with new_recording(path) as author:
        author.write_image("/camera", 1, "camera", b"", "png")
        assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(FileExistsError), new_recording(path):
        pass


def test_an_exception_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), new_recording(tmp_path / "new.mcap") as author:
        author.write_image("/camera", 1 // 0, "camera", b"", "png")
    assert list(tmp_path.iterdir()) == []
