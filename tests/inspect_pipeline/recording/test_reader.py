"""Recordings of any writer: which frames are read, in which order, and as which flight."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING

import factories
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording, number_of, shots
from mcap.reader import NonSeekingReader
from mcap.records import Statistics
from mcap.writer import Writer
from writers import WRITERS, numbers

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

    from mcap.data_stream import RecordBuilder


SDK_WRITERS = {
    "sdk": {},
    "sdk unchunked": {"use_chunks": False},
    "sdk without indexes": {"emit_message_indexes": False, "emit_chunk_indexes": False},
    "sdk without summary": {
        "emit_statistics": False,
        "emit_summary_offsets": False,
        "emit_message_indexes": False,
        "emit_chunk_indexes": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
    "sdk without seeking": {"disable_seeking": True},
}


def log_times_by_plain_reader(path: Path) -> list[int]:
    with path.open("rb") as file:
        reader = NonSeekingReader(file, validate_crcs=True)
        return [m.log_time for _, channel, m in reader.iter_messages() if channel.topic != "/gps"]


@pytest.mark.parametrize("name", WRITERS)
def test_reads_what_the_mcap_package_writes(tmp_path: Path, name: str) -> None:
    path = make_recording(tmp_path / "flight.mcap", shots(20), **WRITERS[name])
    recording = open_recording(path)
    frames = list(iter_frames(recording))
    assert [number_of(f.image) for f in frames] == list(range(20))
    assert [f.frame_idx for f in frames] == list(range(20))
    assert [f.log_time_ns for f in frames] == log_times_by_plain_reader(path)
    assert all(f.publish_time_ns == f.log_time_ns + 1 for f in frames)
    assert all(f.stamp_ns == f.log_time_ns - factories.STAMP_LAG_NS for f in frames)
    assert {(f.topic, f.frame_id, f.error) for f in frames} == {(CAMERA, "cam", None)}
    assert recording.losses == ()
    assert [c.topic for c in recording.channels] == [CAMERA, "/gps"]
    assert (recording.start_ns, recording.end_ns) == (START_NS, START_NS + 19 * STEP_NS + 1)


@pytest.mark.parametrize("name", SDK_WRITERS)
def test_reads_what_foxglove_sdk_writes(tmp_path: Path, name: str) -> None:
    path = factories.make_recording_with_sdk(tmp_path / "flight.mcap", shots(20), **SDK_WRITERS[name])
    assert numbers(path) == [(CAMERA, i, i) for i in range(20)]
    assert open_recording(path).losses == ()


def test_reads_what_rosbags_writes(tmp_path: Path) -> None:
    path = factories.make_recording_with_rosbags(tmp_path / "bag", shots(20))
    assert numbers(path) == [(CAMERA, i, i) for i in range(20)]


@pytest.mark.parametrize("name", ["mcap", "unchunked", "unindexed"])
def test_message_counts_need_no_statistics(tmp_path: Path, name: str) -> None:
    path = make_recording(tmp_path / "flight.mcap", shots(6), **{**WRITERS[name], "use_statistics": False})
    counts = {c.topic: c.message_count for c in open_recording(path).channels}
    assert counts == {CAMERA: 6, "/gps": 12}


@pytest.mark.parametrize("name", ["mcap", "unchunked", "unindexed"])
def test_statistics_without_the_counts_of_channels(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An empty map says that they are not available, as the specification has it."""
    whole = Statistics.write

    def write(self: Statistics, stream: RecordBuilder) -> None:
        whole(replace(self, channel_message_counts={}), stream)

    monkeypatch.setattr(Statistics, "write", write)
    recording = open_recording(make_recording(tmp_path / "flight.mcap", shots(6), **WRITERS[name]))
    assert [camera.topic for camera in recording.camera_channels] == [CAMERA]
    assert recording.message_counts().total() == 18


def test_ties_are_in_file_order_and_cameras_count_apart(tmp_path: Path) -> None:
    to_write = [Shot(i, f"/cam{i % 2}/image", START_NS + i // 4) for i in range(40)]
    path = make_recording(tmp_path / "flight.mcap", to_write)
    assert numbers(path) == [(f"/cam{i % 2}/image", i // 2, i) for i in range(40)]


def test_overlapping_chunks_fit_in_a_small_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two halves of the flight, interleaved in time: what falls out of the cache is read again."""
    monkeypatch.setattr("inspect_pipeline.recording.merge._CACHE_BYTES", 3000)
    to_write = shots(60)[::2] + shots(60)[1::2]
    path = make_recording(tmp_path / "flight.mcap", to_write)
    assert numbers(path) == [(CAMERA, i, i) for i in range(60)]


@pytest.mark.parametrize("name", ["mcap", "unchunked", "unindexed", "no message index"])
def test_frame_idx_counts_frames_that_are_left_out(tmp_path: Path, name: str) -> None:
    path = make_recording(tmp_path / "flight.mcap", shots(30), **WRITERS[name])
    start_ns, end_ns = START_NS + 7 * STEP_NS, START_NS + 20 * STEP_NS
    assert numbers(path, every=7) == [(CAMERA, i, i) for i in (0, 7, 14, 21, 28)]
    assert numbers(path, start_ns=start_ns, end_ns=end_ns) == [(CAMERA, i, i) for i in range(7, 20)]
    assert numbers(path, start_ns=start_ns, end_ns=end_ns, every=5) == [(CAMERA, i, i) for i in (10, 15)]
    assert numbers(path, start_ns=start_ns + 1) == [(CAMERA, i, i) for i in range(8, 30)]
    assert numbers(path, end_ns=START_NS) == []


def test_only_chunks_that_hold_wanted_channels_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    to_write = [*shots(10, "/a/image"), *shots(10, "/b/image", start_ns=START_NS + 10 * STEP_NS)]
    path = make_recording(tmp_path / "flight.mcap", to_write, n_gps_per_shot=0, chunk_size=1)
    recording = open_recording(path)
    n_read = 0
    from inspect_pipeline.recording import merge as recording_merge  # noqa: PLC0415

    read_extent = recording_merge.read_extent

    def count(*args) -> bytes:
        nonlocal n_read
        n_read += 1
        return read_extent(*args)

    monkeypatch.setattr(recording_merge, "read_extent", count)
    assert len(list(iter_frames(recording, recording.select_cameras(["/b/image"])))) == 10
    assert n_read == 10


def test_flight_id_is_the_hash_of_the_content(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "flight.mcap", shots(2))
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(path.read_bytes())
    assert open_recording(path).flight_id == hashlib.sha256(path.read_bytes()).hexdigest()
    assert open_recording(copy).flight_id == open_recording(path).flight_id


@pytest.mark.parametrize("strict", [False, True])
def test_the_flight_id_checks_the_crc_of_unchunked_data(tmp_path: Path, strict: bool) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(5), use_chunking=False, enable_data_crcs=True)
    assert open_recording(path).flight_id
    content = bytearray(path.read_bytes())
    content[content.index(b"latitude") + 2] ^= 1
    path.write_bytes(content)
    recording = open_recording(path, strict=strict)
    if strict:
        with pytest.raises(RecordingError, match="CRC"):
            _ = recording.flight_id
    else:
        assert recording.flight_id == hashlib.sha256(content).hexdigest()
        assert recording.identity.losses == ("its data section does not match its CRC",)


def test_an_annotated_copy_belongs_to_the_flight_it_names(tmp_path: Path) -> None:
    metadata = {"lsnet_pipe.run": {"flight_id": "ab" * 32}}
    recording = open_recording(make_recording(tmp_path / "a.mcap", shots(2), metadata=metadata))
    assert recording.is_annotated_copy
    assert recording.flight_id == "ab" * 32


def test_metadata_and_attachments(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(2), **WRITERS["attachments and metadata"])
    recording = open_recording(path)
    assert recording.metadata == {"mission": {"line": "7"}}
    assert len(recording.parts[0].layout.attachments) == 2
    assert not recording.is_annotated_copy


def test_a_bad_image_is_a_frame_with_a_reason(tmp_path: Path) -> None:
    to_write = shots(4)
    to_write[1] = to_write[1]._replace(data=b"")
    to_write[2] = to_write[2]._replace(data=b"\xff\xd8\xff\xe0 no jpeg at all")
    frames = list(iter_frames(open_recording(make_recording(tmp_path / "a.mcap", to_write))))
    assert [f.frame_idx for f in frames] == [0, 1, 2, 3]
    assert [f.image is None for f in frames] == [False, True, True, False]
    assert [f.error for f in frames] == [None, "the image is empty", "the image cannot be decoded", None]
    assert frames[1].stamp_ns == frames[1].log_time_ns - factories.STAMP_LAG_NS


def test_a_camera_in_two_forms_is_taken_once(tmp_path: Path) -> None:
    to_write = shots(5, "/left/image_raw/compressed") + shots(3, "/left/image_raw") + shots(4, "/right/image")
    recording = open_recording(make_recording(tmp_path / "a.mcap", to_write, encoding="ros2"))
    assert [c.topic for c in recording.select_cameras()] == ["/left/image_raw/compressed", "/right/image"]
    assert [c.topic for c in recording.select_cameras(["/left/image_raw"])] == ["/left/image_raw"]


def test_all_channels_of_a_topic_are_read(tmp_path: Path) -> None:
    """As when a recorder starts a camera again under a new channel id."""
    path = tmp_path / "a.mcap"
    how = factories.ENCODINGS["ros2"]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema_id = writer.register_schema(how.schema_name, how.schema_encoding, how.schema_data)
        ids = [writer.register_channel(CAMERA, how.message_encoding, schema_id) for _ in range(2)]
        for shot in shots(6):
            payload = how.encode(shot.log_time_ns, "cam", factories.encoded_picture(shot.number))
            writer.add_message(ids[shot.number // 4], shot.log_time_ns, payload, shot.log_time_ns)
        writer.finish()
    recording = open_recording(path)
    assert [c.channel_id for c in recording.camera_channels] == ids
    frames = list(iter_frames(recording))
    assert [(f.channel_id, f.frame_idx, number_of(f.image)) for f in frames] == [
        *((ids[0], i, i) for i in range(4)),
        *((ids[1], i, i + 4) for i in range(2)),
    ]


def test_depth_images_are_not_cameras(tmp_path: Path) -> None:
    to_write = shots(2) + shots(2, "/depth/image_raw/compressedDepth")
    recording = open_recording(make_recording(tmp_path / "a.mcap", to_write, encoding="ros2"))
    assert [c.topic for c in recording.camera_channels] == [CAMERA]


@pytest.mark.parametrize(
    ("name", "count", "size"),
    [
        ("brighton_ros2", 18, (1125, 2000, 3)),
        ("caliterra_foxglove", 40, (1500, 2000, 3)),
        ("lichtblick_custom_camera_model", 10, (360, 520, 3)),
        ("pldm_frames", 25, (540, 360, 3)),
        ("pldu_frames", 57, (360, 540, 3)),
    ],
)
def test_real_recordings(data_dir: Path, name: str, count: int, size: tuple[int, int, int]) -> None:
    path = data_dir / "mcap" / f"{name}.mcap"
    frames = list(iter_frames(open_recording(path, strict=True), every=count - 1))
    assert [f.frame_idx for f in frames] == [0, count - 1]
    assert all(f.image is not None and sorted(f.image.shape) == sorted(size) for f in frames)
