"""Damaged recordings: frames or one sentence, never a traceback, a hang or much memory."""

from __future__ import annotations

import random
import shutil
import struct
import time
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING

import factories
import lz4.frame
import pytest
import zstandard
from factories import ENCODINGS, RawPixels, make_recording, shots
from fakes import FakeDetector
from mcap.writer import CompressionType, Writer
from memory import grows_by_less_than

from inspect_pipeline.annotations.protobuf import PROTOBUF
from inspect_pipeline.annotations.ros2 import ROS2
from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.georeference.calibration import LensReader
from inspect_pipeline.georeference.poses import read_poses
from inspect_pipeline.index import publish as index
from inspect_pipeline.pipeline import process
from inspect_pipeline.recording.append import annotated_copy
from inspect_pipeline.recording.file import read_extent
from inspect_pipeline.recording.frames import iter_channel_messages, iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.summary import MAGIC
from inspect_pipeline.recording.writer import new_recording
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

MAX_SECONDS = 10  # of CPU: a busy machine is no hang, and what waits for ever is stopped by pytest
MAX_MEMORY_GROWTH_MB = 400


def sources(folder: Path) -> list[bytes]:
    """Small recordings of every container and encoding."""
    folder.mkdir(exist_ok=True)
    options = [
        {},
        {"compression": CompressionType.LZ4, "encoding": "json"},
        {"compression": CompressionType.NONE, "encoding": "ros2"},
        {"use_chunking": False, "encoding": "ros1"},
        {"index_types": factories.UNINDEXED, "use_statistics": False, "encoding": "flatbuffer"},
        {"enable_crcs": False, "repeat_channels": False, "encoding": "foxglove ros2"},
        {"enable_crcs": False, "compression": CompressionType.NONE, "attachments": [b"x" * 50]},
        {"enable_crcs": False, "metadata": {"mission": {"line": "7"}}, "encoding": "json"},
    ]
    made = [make_recording(folder / f"{i}.mcap", shots(5), **o).read_bytes() for i, o in enumerate(options)]
    jpegs = [shot._replace(data=factories.encoded_picture(shot.number, ".jpg")) for shot in shots(5)]
    made.append(make_recording(folder / "jpeg.mcap", jpegs, enable_crcs=False).read_bytes())
    pixels = RawPixels("bayer_rggb8", 12, 16, 16, bytes(12 * 16))
    raws = [shot._replace(data=pixels) for shot in shots(5)]
    raw_encoding = factories.RAW_ENCODINGS["ros2"]
    path = make_recording(folder / "raw.mcap", raws, encoding=raw_encoding, compression=CompressionType.NONE)
    made.append(path.read_bytes())
    with new_recording(folder / "posed.mcap") as author:
        for shot in shots(5):
            time_ns, image = shot.log_time_ns, factories.encoded_picture(shot.number)
            author.write_location(
                "/gps", time_ns, "gps", latitude_deg=47.0, longitude_deg=8.0, altitude_m=9.0
            )
            author.write_attitude("/gimbal", time_ns, "map", "camera", (1.0, 0.0, 0.0, 0.0))
            author.write_calibration(
                "/camera/calibration",
                time_ns,
                "camera",
                image_size=(12, 16),
                focal_px=(9.0, 9.0),
                centre_px=(8.0, 6.0),
            )
            author.write_image("/camera/image", time_ns, "camera", image, "png")
    made.append((folder / "posed.mcap").read_bytes())
    video = factories.Encoding(
        "foxglove.CompressedVideo", "jsonschema", b"{}", "json", ENCODINGS["json"].encode
    )
    stream = [b"\0\0\0\1\x67" + bytes(range(9)), *[b"\0\0\0\1\x41" + bytes(range(30))] * 4]
    pieces = [shot._replace(data=data) for shot, data in zip(shots(5), stream, strict=True)]
    path = make_recording(folder / "video.mcap", pieces, encoding=video, enable_crcs=False)
    return [*made, path.read_bytes()]


def mutate(content: bytes, random: random.Random) -> bytes:
    """One to three of: flip bits, cut, overwrite a number, repeat, remove or insert a stretch."""
    changed = bytearray(content)
    for _ in range(random.randint(1, 3)):
        at = random.randrange(len(changed))
        stretch = random.randint(1, 64)
        match random.randrange(7):
            case 0 | 1:
                changed[at] ^= 1 << random.randrange(8)
            case 2:
                del changed[max(at, 9) :]
            case 3:
                number = random.choice([0, 1, 2**16 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1])
                size = random.choice([2, 4, 8])
                changed[at : at + size] = (number % 2 ** (8 * size)).to_bytes(size, "little")
            case 4:
                changed[at:at] = changed[at : at + stretch]
            case 5:
                del changed[at : at + stretch]
            case 6:
                changed[at : at + stretch] = random.randbytes(stretch)
        if not changed:
            return b""
    return bytes(changed)


def use(path: Path, target: Path) -> int:
    """Read a recording and annotate it, the part of `process` that damage can hurt; the number of frames."""
    target.unlink(missing_ok=True)
    try:
        recording = open_recording(path)
        reader = LensReader(recording)
        read_poses(recording, reader)
        reader.lenses()
        with annotated_copy(recording, target) as out:
            channel_id = out.add_channel(
                "/notes",
                schema_name="",
                schema_encoding="",
                schema_data=b"",
                message_encoding="json",
                metadata={},
            )
            n_frames = 0
            for frame in iter_frames(recording):
                assert (frame.image is None) == (frame.error is not None)
                out.write(channel_id, frame.log_time_ns, frame.publish_time_ns, b"{}")
                for schema in (*PROTOBUF, *ROS2):
                    schema.encode(frame, None)
                n_frames += 1
    except RecordingError as error:
        message = str(error)
    else:
        copy = open_recording(target)
        assert [c.message_count for c in copy.channels if c.topic == "/notes"] == [n_frames]
        return n_frames
    assert str(path) in message
    assert "\n" not in message
    assert not target.exists()
    return 0


def process_whole(path: Path, store: Store) -> None:
    """The whole of `process`, with the index at its end."""
    detector, options = FakeDetector(), ProcessOptions()
    with suppress(RecordingError):
        process(path, store, detector, options, start_run(detector, options))
        index.publish(store)


def check(tmp_path: Path, contents: Iterable[tuple[str, bytes]], process_every: int = 0) -> int:
    """Use each content of a recording; how many had frames."""
    with grows_by_less_than(MAX_MEMORY_GROWTH_MB):
        return use_each(tmp_path, contents, process_every)


def use_each(tmp_path: Path, contents: Iterable[tuple[str, bytes]], process_every: int) -> int:
    path, target, store = tmp_path / "mutated.mcap", tmp_path / "annotated.mcap", Store(tmp_path / "store")
    n_read = 0
    for number, (name, content) in enumerate(contents):
        path.write_bytes(content)
        started = time.process_time()
        try:
            n_read += bool(use(path, target))
            if process_every and number % process_every == 0:
                process_whole(path, store)
                shutil.rmtree(store.root, ignore_errors=True)
            assert time.process_time() - started < MAX_SECONDS
        except Exception as error:
            kept = tmp_path / f"failed-{name}.mcap"
            kept.write_bytes(content)
            raise AssertionError(f"{name}, kept as {kept}") from error
    return n_read


def mutations(originals: Sequence[bytes], count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    generator = random.Random(seed)  # noqa: S311
    for number in range(count):
        yield f"{seed}-{number}", mutate(generator.choice(originals), generator)


def test_some_mutations(tmp_path: Path) -> None:
    originals = sources(tmp_path / "sources")
    assert check(tmp_path, mutations(originals, 300, seed=1), process_every=100) > 75


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(2, 6))
def test_many_mutations(tmp_path: Path, seed: int) -> None:
    originals = sources(tmp_path / "sources")
    assert check(tmp_path, mutations(originals, 5_000, seed), process_every=10) > 1250


def cuts(originals: Iterable[bytes]) -> Iterator[tuple[str, bytes]]:
    """Every recording cut off at, before and behind every record."""
    for number, content in enumerate(originals):
        at = len(MAGIC)
        while at + 9 <= len(content):
            for length in (at - 1, at, at + 1, at + 9):
                yield f"cut-{number}-{length}", content[:length]
            at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_cuts_at_every_record(tmp_path: Path) -> None:
    originals = sources(tmp_path / "sources")
    assert check(tmp_path, cuts(originals), process_every=10) > 600


@pytest.mark.parametrize("use_chunking", [True, False])
def test_an_id_that_is_used_twice(tmp_path: Path, use_chunking: bool) -> None:
    """Of two channels with one id the images still come, under one topic."""
    path = tmp_path / "a.mcap"
    how = ENCODINGS["ros2"]
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=use_chunking, chunk_size=1)
        writer.start()
        for topic in ("/a/image", "/b/image"):
            schema_id = writer.register_schema(how.schema_name, "ros2msg", topic.encode())
            channel_id = writer.register_channel(topic, how.message_encoding, schema_id)
            for shot in shots(3):
                payload = how.encode(shot.log_time_ns, "cam", factories.encoded_picture(shot.number))
                writer.add_message(channel_id, shot.log_time_ns, payload, shot.log_time_ns)
            writer._Writer__channels.clear()  # so that the ids begin anew
            writer._Writer__schemas.clear()
        writer.finish()
    assert use(path, tmp_path / "b.mcap") == 6


@cache
def compressed_zeros(compression: str, n_bytes: int) -> bytes:
    zeros = bytes(n_bytes)
    return zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)


def bomb(tmp_path: Path, compression: str, declared_bytes: int, data: bytes) -> Path:
    """A recording whose only chunk has this data."""
    path = make_recording(tmp_path / "a.mcap", shots(2), index_types=factories.UNINDEXED)
    start = path.read_bytes()[: open_recording(path).parts[0].layout.extents[0].offset]
    name = compression.encode()
    body = (
        struct.pack("<QQQII", 1, 2, declared_bytes, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    )
    path.write_bytes(start + struct.pack("<BQ", 6, len(body)) + body)
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("declared_bytes", [100, 200 << 20, 1 << 40])
def test_decompression_bombs_take_no_memory(tmp_path: Path, compression: str, declared_bytes: int) -> None:
    path = bomb(tmp_path, compression, declared_bytes, compressed_zeros(compression, 300 << 20))
    started = time.process_time()
    recording = open_recording(path)
    assert len(recording.losses) == 2  # the chunk, and the missing end
    with pytest.raises(RecordingError, match="no camera topic"):
        iter_frames(recording)
    assert time.process_time() - started < MAX_SECONDS


def test_a_message_of_absurd_length_takes_no_memory(tmp_path: Path) -> None:
    """It is all there, in a file with a hole; what stands before it is read."""
    path = make_recording(tmp_path / "a.mcap", shots(5), use_chunking=False, n_gps_per_shot=0)
    recording = open_recording(path)
    channel_id, length = recording.camera_channels[0].channel_id, 1 << 30
    start = path.read_bytes()[: recording.parts[0].layout.data_end]
    head = struct.pack("<BQHIQQ", 5, length, channel_id, 0, factories.START_NS, factories.START_NS)
    path.write_bytes(start + head)
    with path.open("r+b") as file:
        file.truncate(len(start) + 9 + length)
    with grows_by_less_than(100):
        recording = open_recording(path)
        frames = iter_frames(recording)
        assert len(list(frames)) == 5
    assert "a message claims more than 256 MiB" in frames.losses[-1]


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_of_nothing_but_zeros_is_damage(tmp_path: Path, compression: str) -> None:
    data = compressed_zeros(compression, 1 << 20)
    recording = open_recording(bomb(tmp_path, compression, 1 << 20, data))
    assert "a chunk ends inside a record" in recording.losses[-1]


def whole_chunk(tmp_path: Path) -> bytes:
    """The records of a chunk with the pictures 0 to 4 and their channel."""
    path = make_recording(tmp_path / "whole.mcap", shots(5), chunk_size=1 << 20, n_gps_per_shot=0)
    part = open_recording(path).parts[0]
    with part.open() as file:
        return read_extent(file, part.layout.extents[0])


@pytest.mark.parametrize("compression", ["zstd", "lz4", "ZSTD"])
def test_a_chunk_of_several_compressed_frames(tmp_path: Path, compression: str) -> None:
    records = whole_chunk(tmp_path)
    compress = lz4.frame.compress if compression == "lz4" else zstandard.compress
    frames = b"".join(compress(part) for part in (records[:100], records[100:300], records[300:]))
    recording = open_recording(bomb(tmp_path, compression, len(records), frames))
    assert [factories.number_of(frame.image) for frame in iter_frames(recording)] == list(range(5))


@pytest.mark.parametrize(
    ("compression", "reason"),
    [("lzma", "a chunk is compressed with 'lzma', not none, lz4 or zstd"), ("", "a chunk has another size")],
)
def test_why_nothing_can_be_read_is_in_the_error(tmp_path: Path, compression: str, reason: str) -> None:
    records = whole_chunk(tmp_path)
    recording = open_recording(bomb(tmp_path, compression, len(records), records[1:]))
    with pytest.raises(RecordingError, match="no camera topic in the part that can be read; .*" + reason):
        recording.select_cameras()


@pytest.mark.parametrize("record", [struct.pack("<BQHIQQ", 5, 22, 1, 0, 7, 7), struct.pack("<BQ", 0x80, 0)])
def test_a_million_records_in_few_bytes_are_damage(tmp_path: Path, record: bytes) -> None:
    records = whole_chunk(tmp_path) + record * 1_000_000
    path = bomb(tmp_path, "zstd", len(records), zstandard.compress(records))
    assert path.stat().st_size < 10_000
    started = time.process_time()
    with pytest.raises(RecordingError, match=r"a chunk of [\d,]+ bytes claims more than [\d,]+ records"):
        open_recording(path).select_cameras()
    assert time.process_time() - started < MAX_SECONDS


def test_many_small_messages_are_no_damage(tmp_path: Path) -> None:
    """As of a heartbeat: equal in all but their times, which take a few bytes even when compressed."""
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file, chunk_size=4 << 20)
        writer.start()
        channel_id = writer.register_channel("/heartbeat", "json", 0)
        for i in range(30_000):
            writer.add_message(
                channel_id, factories.START_NS + i * 1000, b"{}", factories.START_NS + i * 1000
            )
        writer.finish()
    recording = open_recording(tmp_path / "a.mcap")
    messages = iter_channel_messages(recording, {channel_id})
    assert len(list(messages)) == 30_000
    assert messages.losses == ()
