"""Damaged recordings: frames or one sentence, never a traceback, a hang or much memory."""

from __future__ import annotations

import random
import resource
import struct
import time
from typing import TYPE_CHECKING

import factories
import lz4.frame
import pytest
import zstandard
from factories import RawPixels, make_recording, shots
from mcap.writer import CompressionType

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording import open_recording
from inspect_pipeline.recording_frames import iter_frames
from inspect_pipeline.writeback import annotated_copy

if TYPE_CHECKING:
    from pathlib import Path

MAX_SECONDS = 10
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
    """Read a recording and annotate it, as `process` does; the number of frames."""
    target.unlink(missing_ok=True)
    try:
        recording = open_recording(path)
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


def check_mutations(tmp_path: Path, n_mutations: int, seed: int) -> None:
    generator = random.Random(seed)  # noqa: S311
    originals = sources(tmp_path / "sources")
    path, target = tmp_path / "mutated.mcap", tmp_path / "annotated.mcap"
    memory_before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    n_read = 0
    for number in range(n_mutations):
        content = mutate(generator.choice(originals), generator)
        path.write_bytes(content)
        started = time.monotonic()
        try:
            n_read += bool(use(path, target))
            assert time.monotonic() - started < MAX_SECONDS
        except Exception as error:
            kept = tmp_path / f"failed-{seed}-{number}.mcap"
            kept.write_bytes(content)
            raise AssertionError(f"mutation {number} of seed {seed}, kept as {kept}") from error
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory_before_kb
    assert grown_kb < MAX_MEMORY_GROWTH_MB * 1024
    assert n_read > n_mutations // 4


def test_some_mutations(tmp_path: Path) -> None:
    check_mutations(tmp_path, 300, seed=1)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_many_mutations(tmp_path: Path) -> None:
    check_mutations(tmp_path, 20_000, seed=2)


def bomb(tmp_path: Path, compression: str, declared_bytes: int, data: bytes) -> Path:
    """A recording whose only chunk has this data."""
    path = make_recording(tmp_path / "a.mcap", shots(2), index_types=factories.UNINDEXED)
    start = path.read_bytes()[: open_recording(path).layout.extents[0].offset]
    name = compression.encode()
    body = (
        struct.pack("<QQQII", 1, 2, declared_bytes, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    )
    path.write_bytes(start + struct.pack("<BQ", 6, len(body)) + body)
    return path


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("declared_bytes", [100, 200 << 20, 1 << 40])
def test_decompression_bombs_take_no_memory(tmp_path: Path, compression: str, declared_bytes: int) -> None:
    zeros = bytes(300 << 20)
    data = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    del zeros
    path = bomb(tmp_path, compression, declared_bytes, data)
    started = time.monotonic()
    recording = open_recording(path)
    assert len(recording.losses) == 2  # the chunk, and the missing end
    with pytest.raises(RecordingError, match="no camera topic"):
        iter_frames(recording)
    assert time.monotonic() - started < MAX_SECONDS


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_of_nothing_but_zeros_is_damage(tmp_path: Path, compression: str) -> None:
    zeros = bytes(1 << 20)
    data = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    recording = open_recording(bomb(tmp_path, compression, len(zeros), data))
    assert "a chunk ends inside a record" in recording.losses[-1]
