from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest
from factories import CAMERA, START_NS, STEP_NS, make_recording, make_recording_with_rosbags, number_of, shots
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Attachment
from rosbags.rosbag2 import Reader as BagReader

from inspect_pipeline.convert.pack import PackResult, pack
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.split import find_parts
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from pathlib import Path

OTHER = "/left/image/compressed"


def messages(path: Path) -> list[tuple[str, str, int, int, bytes]]:
    with path.open("rb") as file:
        found = NonSeekingReader(file, validate_crcs=True).iter_messages()
        return [(c.topic, s.name, m.log_time, m.publish_time, m.data) for s, c, m in found]


def part(folder: Path, name: str, first: int, topics: tuple[str, ...], **options) -> Path:
    """Four shots per topic; the topic that comes first gets the lower channel id."""
    folder.mkdir(exist_ok=True)
    in_order = [shot for topic in topics for shot in shots(first + 4, topic)[first:]]
    return make_recording(folder / name, in_order, **options)


def test_numbered_parts_become_one_recording(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    names = ["f_9.mcap", "f_10.mcap", "f_11.mcap"]
    ids = [(CAMERA, OTHER), (OTHER, CAMERA), (CAMERA,)]  # numbered differently in the second
    parts = [
        part(folder, name, 4 * i, topics) for i, (name, topics) in enumerate(zip(names, ids, strict=True))
    ]
    target = tmp_path / "a.mcap"

    n_messages = sum(len(messages(path)) for path in parts)
    assert pack(folder, target) == PackResult({"parts": 3, "messages": n_messages})
    assert sorted(messages(target)) == sorted(message for path in parts for message in messages(path))
    recording = open_recording(target)
    assert recording.profile == "test"
    frames = [frame for frame in iter_frames(recording) if frame.topic == CAMERA]
    assert [number_of(frame.image) for frame in frames] == list(range(12))
    assert [frame.frame_idx for frame in frames] == list(range(12))
    assert len(recording.channels) == 3  # two cameras and /gps


def test_attachments_and_metadata_are_kept(tmp_path: Path) -> None:
    part(
        tmp_path / "b", "f_0.mcap", 0, (CAMERA,), attachments=[b"notes"], metadata={"mission": {"line": "7"}}
    )
    part(tmp_path / "b", "f_1.mcap", 4, (CAMERA,), attachments=[b"more"])
    with new_recording(tmp_path / "b" / "f_2.mcap") as author:  # two of one name
        author.add_metadata("battery", {"percent": "90"})
        author.add_metadata("battery", {"percent": "10"})
    pack(tmp_path / "b", tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        assert [a.data for a in reader.iter_attachments() if isinstance(a, Attachment)] == [b"notes", b"more"]
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [
            ("mission", {"line": "7"}),
            ("battery", {"percent": "90"}),
            ("battery", {"percent": "10"}),
        ]


def test_a_rosbag2_is_joined_as_its_metadata_lists_it(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    make_recording_with_rosbags(bag, shots(4))
    second = make_recording_with_rosbags(tmp_path / "more", shots(4, start_ns=START_NS + 4 * STEP_NS))
    shutil.copy(second, bag / "z.mcap")
    (bag / "stray.mcap").write_bytes(b"not of this bag")
    index = bag / "metadata.yaml"
    (first,) = (path.name for path in bag.glob("bag*.mcap"))
    lines = index.read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if line.strip().startswith(f"- {first}"))
    lines.insert(at + 1, lines[at].replace(first, "z.mcap"))
    index.write_text("".join(lines))
    target = tmp_path / "a.mcap"

    assert pack(bag, target).counts == {"parts": 2, "messages": 8}
    frames = list(iter_frames(open_recording(target)))
    assert [frame.log_time_ns for frame in frames] == [START_NS + i * STEP_NS for i in range(8)]
    joined = tmp_path / "joined"  # and rosbags reads what was made
    joined.mkdir()
    shutil.copy(target, joined / first)
    shutil.copy(tmp_path / "more" / "metadata.yaml", joined)
    (joined / "metadata.yaml").write_text((joined / "metadata.yaml").read_text().replace(second.name, first))
    with BagReader(joined) as reader:
        assert [time_ns for _, time_ns, _ in reader.messages()] == [f.log_time_ns for f in frames]


def test_metadata_as_rosbag2_writes_it_since_version_5(tmp_path: Path) -> None:
    """It names every part twice: in a list of names, and in one of what is in them."""
    names = ("a b_0.mcap", "2026-05-04T09:30:00_1.mcap")
    listed = "".join(f"    - {name}\n" for name in names)
    described = "".join(f"    - path: {name}\n      message_count: 4\n" for name in names)
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n"
        f"  relative_file_paths:\n{listed}  files:\n{described}"
    )
    parts = [tmp_path / name for name in names]
    for path in parts:
        path.touch()
    assert find_parts(tmp_path) == parts


def test_a_damaged_part_is_joined_up_to_the_damage(tmp_path: Path) -> None:
    part(tmp_path / "b", "f_0.mcap", 0, (CAMERA,))
    cut = part(tmp_path / "b", "f_1.mcap", 4, (CAMERA,), use_chunking=False)
    cut.write_bytes(cut.read_bytes()[:-2000])
    result = pack(tmp_path / "b", tmp_path / "a.mcap")
    assert len(result.warnings) == 1
    assert result.warnings[0].startswith("f_1.mcap: ")
    assert len(list(iter_frames(open_recording(tmp_path / "a.mcap")))) > 4


def test_other_folders_are_refused(tmp_path: Path) -> None:
    part(tmp_path / "b", "morning_0.mcap", 0, (CAMERA,))
    part(tmp_path / "b", "evening_1.mcap", 4, (CAMERA,))
    with pytest.raises(RecordingError, match="not parts of one"):
        pack(tmp_path / "b", tmp_path / "a.mcap")
    (tmp_path / "b" / "metadata.yaml").write_text("files:\n  - morning_0.mcap\n  - gone.mcap\n")
    with pytest.raises(RecordingError, match="lists it but it is absent"):
        pack(tmp_path / "b", tmp_path / "a.mcap")
    part(tmp_path / "c", "f_0.mcap", 0, (CAMERA,), metadata={"lsnet_pipe.run": {"flight_id": "00"}})
    with pytest.raises(RecordingError, match="carries annotations"):
        pack(tmp_path / "c", tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()
