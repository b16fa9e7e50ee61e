from __future__ import annotations

import errno
import struct
from collections import Counter
from typing import TYPE_CHECKING

import factories
import pytest
from factories import CAMERA, START_NS, STEP_NS, make_recording, shots
from mcap.reader import NonSeekingReader, make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.append import AnnotationWriter, annotated_copy, sidecar
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

SOURCES = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "unchunked": {"use_chunking": False},
    "unindexed": {"index_types": factories.UNINDEXED},
    "no message index": {"index_types": factories.NO_MESSAGE_INDEX},
    "no statistics": {"use_statistics": False},
    "nothing repeated": {"repeat_channels": False, "repeat_schemas": False},
    "data crc": {"enable_data_crcs": True},
    "no crcs": {"enable_crcs": False},
    "attachments and metadata": {"attachments": [b"a" * 5000], "metadata": {"mission": {"line": "7"}}},
    "empty": {},
}
TOPIC = CAMERA + "/lsnet/annotations"


def add_channel(out: AnnotationWriter, topic: str = TOPIC) -> int:
    return out.add_channel(
        topic,
        schema_name="Note",
        schema_encoding="jsonschema",
        schema_data=b"{}",
        message_encoding="json",
        metadata={"of": "test"},
    )


def annotate(source: Path, target: Path, n_notes: int = 12, write=annotated_copy) -> None:
    with write(open_recording(source), target) as out:
        channel_id = add_channel(out)
        for i in range(n_notes):
            out.write(channel_id, START_NS + i * STEP_NS, START_NS + i, b'{"note": %d}' % i)
        out.add_metadata("lsnet_pipe.run", {"flight_id": "00"})


def messages(path: Path, *, seeking: bool) -> list[tuple[str, int, int, bytes]]:
    with path.open("rb") as file:
        reader = (make_reader if seeking else NonSeekingReader)(file, validate_crcs=True)
        return [(c.topic, m.log_time, m.publish_time, m.data) for _, c, m in reader.iter_messages()]


@pytest.mark.parametrize("name", SOURCES)
def test_a_copy_holds_the_source_and_the_annotations(tmp_path: Path, name: str) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(0 if name == "empty" else 12), **SOURCES[name])
    target = tmp_path / "b.mcap"
    data_end = open_recording(source).parts[0].layout.data_end
    annotate(source, target)

    assert target.read_bytes()[:data_end] == source.read_bytes()[:data_end]
    notes = [(TOPIC, START_NS + i * STEP_NS, START_NS + i, b'{"note": %d}' % i) for i in range(12)]
    expected = Counter(messages(source, seeking=False) + notes)
    for seeking in (True, False):
        found = messages(target, seeking=seeking)
        assert Counter(found) == expected
        assert [m[1] for m in found] == sorted(m[1] for m in found)


def test_impossible_statistics_are_ignored(tmp_path: Path) -> None:
    """What they count of each channel is beyond what 64 bits hold of all together."""
    source = make_recording(tmp_path / "a.mcap", shots(12), enable_crcs=False)
    data = bytearray(source.read_bytes())
    for count in (struct.pack("<HQ", 1, 24), struct.pack("<HQ", 2, 12)):
        at = data.rindex(count)
        data[at + 2 : at + 10] = (1 << 63).to_bytes(8, "little")
    source.write_bytes(data)
    annotate(source, tmp_path / "b.mcap")
    assert {c.topic: c.message_count for c in open_recording(source).channels} == {CAMERA: 12, "/gps": 24}
    assert len(messages(tmp_path / "b.mcap", seeking=True)) == 48


@pytest.mark.parametrize("name", SOURCES)
def test_the_summary_agrees_with_the_data(tmp_path: Path, name: str) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(0 if name == "empty" else 12), **SOURCES[name])
    target = tmp_path / "b.mcap"
    annotate(source, target)
    with target.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        attachments, metadata = list(reader.iter_attachments()), list(reader.iter_metadata())
        file.seek(0)
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    found = messages(target, seeking=False)
    kinds = Counter(type(record).__name__ for record in records)
    statistics = summary.statistics
    topics = {channel.id: channel.topic for channel in summary.channels.values()}
    assert statistics.message_count == len(found)
    counts = {topics[i]: n for i, n in statistics.channel_message_counts.items()}
    assert counts == Counter(message[0] for message in found)
    assert statistics.message_start_time == min(message[1] for message in found)
    assert statistics.message_end_time == max(message[1] for message in found)
    assert statistics.chunk_count == kinds["Chunk"]
    assert statistics.attachment_count == len(attachments) == kinds["Attachment"]
    assert statistics.metadata_count == len(metadata) == kinds["Metadata"]
    assert statistics.channel_count == len(summary.channels)
    assert statistics.schema_count == len(summary.schemas)
    assert metadata[-1].name == "lsnet_pipe.run"
    if name == "attachments and metadata":
        assert [(a.name, a.media_type, a.data) for a in attachments] == [
            ("notes.txt", "text/plain", b"a" * 5000)
        ]
        assert metadata[0].metadata == {"line": "7"}
    assert all(record.group_length for record in records if type(record).__name__ == "SummaryOffset")
    if name in {"unchunked", "unindexed", "no message index"}:
        assert summary.chunk_indexes == []
    else:
        offsets = sorted(index.chunk_start_offset for index in summary.chunk_indexes)
        assert len(set(offsets)) == kinds["Chunk"]


def test_the_data_crc_is_continued(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(5), enable_data_crcs=True)
    annotate(source, tmp_path / "b.mcap")
    with (tmp_path / "b.mcap").open("rb") as file:
        (data_end,) = (
            r for r in StreamReader(file, validate_crcs=True).records if type(r).__name__ == "DataEnd"
        )
    assert data_end.data_section_crc


def test_annotation_chunks_are_short_in_time_and_size(tmp_path: Path) -> None:
    source, target = make_recording(tmp_path / "a.mcap", shots(100)), tmp_path / "b.mcap"
    with annotated_copy(open_recording(source), target) as out:
        channel_id = add_channel(out)
        for i in range(100):
            out.write(channel_id, START_NS + i * STEP_NS, START_NS, b"x" * (100_000 if i > 50 else 10))
    with target.open("rb") as file:
        added = [
            c for c in make_reader(file).get_summary().chunk_indexes if channel_id in c.message_index_offsets
        ]
    assert all(c.message_end_time - c.message_start_time <= 5 * 10**9 for c in added)
    assert all(c.uncompressed_size < 400_000 for c in added)
    assert len(added) >= 20


def test_new_ids_are_above_those_missing_in_the_summary(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(5), repeat_channels=False, repeat_schemas=False)
    with source.open("rb") as file:
        used = [r.id for r in StreamReader(file).records if type(r).__name__ == "Channel"]
    with annotated_copy(open_recording(source), tmp_path / "b.mcap") as out:
        assert add_channel(out) == max(used) + 1
        assert add_channel(out, TOPIC + "2") == max(used) + 2


def test_channels_of_one_schema_share_it(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(2))
    with annotated_copy(open_recording(source), tmp_path / "b.mcap") as out:
        add_channel(out), add_channel(out, TOPIC + "2")
    names = [c.schema_name for c in open_recording(tmp_path / "b.mcap").channels]
    assert names.count("Note") == 2
    assert len(open_recording(tmp_path / "b.mcap").parts[0].layout.schemas) == 3


def test_a_sidecar_holds_the_annotations_only(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(12))
    annotate(source, tmp_path / "b.mcap", write=sidecar)
    notes = [(TOPIC, START_NS + i * STEP_NS, START_NS + i, b'{"note": %d}' % i) for i in range(12)]
    assert messages(tmp_path / "b.mcap", seeking=True) == notes
    assert messages(tmp_path / "b.mcap", seeking=False) == notes
    assert open_recording(tmp_path / "b.mcap", strict=True).is_annotated_copy


def test_a_copy_is_not_annotated_again(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(2))
    annotate(source, tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match="already"):
        annotate(tmp_path / "b.mcap", tmp_path / "c.mcap")
    assert not (tmp_path / "c.mcap").exists()


@pytest.mark.parametrize("write", [annotated_copy, sidecar])
def test_a_topic_that_the_recording_has_is_refused(tmp_path: Path, write) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(2, TOPIC))
    with pytest.raises(RecordingError, match=f"channel {TOPIC} already"):
        annotate(source, tmp_path / "b.mcap", write=write)
    assert not (tmp_path / "b.mcap").exists()


def test_an_exception_leaves_no_file_and_the_source_as_it_was(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(2))
    before = source.read_bytes()
    with (
        pytest.raises(ZeroDivisionError),
        annotated_copy(open_recording(source), tmp_path / "b.mcap") as out,
    ):
        out.write(add_channel(out), START_NS, 1 // 0, b"{}")
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert source.read_bytes() == before


def test_a_source_that_changes_is_refused(tmp_path: Path) -> None:
    source = make_recording(tmp_path / "a.mcap", shots(2))
    with (
        pytest.raises(RecordingError, match="changed"),
        annotated_copy(open_recording(source), tmp_path / "b.mcap"),
        source.open("ab") as file,
    ):
        file.write(b"more")
    assert not (tmp_path / "b.mcap").exists()


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    source, target = make_recording(tmp_path / "a.mcap", shots(2)), tmp_path / "b.mcap"
    target.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        annotate(source, target)
    assert target.read_bytes() == b"precious"


def test_a_file_system_without_copy_range_is_copied_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args) -> int:
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr("os.copy_file_range", refuse)
    source = make_recording(tmp_path / "a.mcap", shots(5))
    annotate(source, tmp_path / "b.mcap")
    assert len(messages(tmp_path / "b.mcap", seeking=True)) == 5 * 3 + 12


@pytest.mark.parametrize(("call", "error"), [("pread", RecordingError), ("pwrite", OSError)])
def test_errors_of_the_source_differ_from_those_of_the_target(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, error: type[Exception]
) -> None:
    def refuse(*args) -> int:
        raise OSError(errno.EIO, "Input/output error")

    source = make_recording(tmp_path / "a.mcap", shots(5))
    for name in ("copy_file_range", call):
        monkeypatch.setattr(f"os.{name}", refuse)
    with pytest.raises(error, match="Input/output error"):
        annotate(source, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


@pytest.mark.parametrize("name", ["zstd", "unchunked", "unindexed"])
def test_the_readable_part_of_a_truncated_recording_is_annotated(tmp_path: Path, name: str) -> None:
    whole = make_recording(tmp_path / "whole.mcap", shots(12), **SOURCES[name]).read_bytes()
    source, target = tmp_path / "a.mcap", tmp_path / "b.mcap"
    for length in range(1200, len(whole), 173):
        source.write_bytes(whole[:length])
        recording = open_recording(source)
        n_frames = len(list(iter_frames(recording)))
        target.unlink(missing_ok=True)
        annotate(source, target)
        counts = Counter(message[0] for message in messages(target, seeking=True))
        assert (counts[CAMERA], counts[TOPIC]) == (n_frames, 12)
        assert open_recording(target, strict=True).losses == ()


def test_real_recordings(data_dir: Path, tmp_path: Path) -> None:
    for source in sorted((data_dir / "mcap").glob("*.mcap")):
        target = tmp_path / source.name
        annotate(source, target)
        expected = Counter(message[0] for message in messages(source, seeking=True)) + Counter({TOPIC: 12})
        assert Counter(message[0] for message in messages(target, seeking=True)) == expected
        data_end = open_recording(source).parts[0].layout.data_end
        assert target.read_bytes()[:data_end] == source.read_bytes()[:data_end]
