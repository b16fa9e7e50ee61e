"""Frames whose log times are far from all others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import factories
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording

from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.log_times import FrameChecks, TimeRange
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.types import Frame

if TYPE_CHECKING:
    from pathlib import Path

REGULAR = [START_NS + i * STEP_NS for i in range(30)]
DAY_NS = 86_400 * 10**9
NEVER_NS = 2**64 - 1
HOW: list[dict[str, Any]] = [{}, {"use_chunking": False}, {"index_types": factories.UNINDEXED}]


def read(folder: Path, times_ns: list[int], **options: Any) -> tuple[list[tuple[int, int]], list[str]]:
    """(frame_idx, log time) of the frames of a recording with these log times, and the warnings."""
    to_write = [Shot(i, CAMERA, time_ns) for i, time_ns in enumerate(times_ns)]
    # Stamps are the log times less a little, so the writer must not see those below 0.
    how = factories.ENCODINGS["protobuf"]
    encoding = factories.Encoding(
        how.schema_name,
        "protobuf",
        how.schema_data,
        "protobuf",
        lambda _, frame, data: how.encode(7, frame, data),
    )
    path = make_recording(folder / "a.mcap", to_write, encoding=encoding, n_gps_per_shot=0, **options)
    frames = iter_frames(open_recording(path))
    return [(frame.frame_idx, frame.log_time_ns) for frame in frames], [
        warning for warning in frames.warnings if "set aside" in warning
    ]


@pytest.mark.parametrize("how", HOW, ids=["indexed", "unchunked", "unindexed"])
@pytest.mark.parametrize(
    ("outliers", "first_idx"),
    [([0, 0, 0], 3), ([NEVER_NS - 1], 0), ([0, 5, START_NS + 400 * DAY_NS], 2)],
    ids=["zero", "end of time", "both sides"],
)
def test_outliers_are_set_aside_and_counted(
    tmp_path: Path, how: dict[str, Any], outliers: list[int], first_idx: int
) -> None:
    frames, warnings = read(tmp_path, [*outliers, *REGULAR], **how)
    assert frames == [(first_idx + i, time_ns) for i, time_ns in enumerate(REGULAR)]
    noun = "image" if len(outliers) == 1 else "images"
    assert warnings == [f"{CAMERA}: {len(outliers)} {noun} set aside: log times far from all others"]


@pytest.mark.parametrize(
    "times_ns",
    [
        [0] * 10,
        [NEVER_NS - 1] * 3,
        [*REGULAR[:15], *(time_ns + DAY_NS for time_ns in REGULAR[15:])],
        [START_NS, START_NS + 400 * DAY_NS],
        [*REGULAR[:12], *(time_ns + 400 * DAY_NS for time_ns in REGULAR[12:])],  # which are the outliers?
        REGULAR[::-1],
    ],
    ids=["all zero", "all at the end", "a day later", "two", "two groups", "reversed"],
)
def test_nothing_else_is_set_aside(tmp_path: Path, times_ns: list[int]) -> None:
    frames, warnings = read(tmp_path, times_ns)
    assert [time_ns for _, time_ns in frames] == sorted(min(time_ns, 2**63 - 1) for time_ns in times_ns)
    assert warnings == []


def test_the_usual_times_of_a_recording(tmp_path: Path) -> None:
    read(tmp_path, [0, *REGULAR])
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.usual_times(recording.camera_channels) == (REGULAR[0], REGULAR[-1])
    read(tmp_path, REGULAR)
    recording = open_recording(tmp_path / "a.mcap")
    assert recording.usual_times(recording.camera_channels) == TimeRange()


def stamp_warnings(*stamps: tuple[str, int]) -> list[str]:
    check = FrameChecks()
    for i, (topic, stamp_ns) in enumerate(stamps):
        check.check(Frame(1, topic, i, i, i, stamp_ns, "cam", None, "no image"))
    return list(check.warnings())


def test_stamps_in_order_give_no_warning() -> None:
    assert stamp_warnings(("/a", 1), ("/b", 1), ("/a", 2), ("/b", 2)) == []
    assert stamp_warnings() == []


def test_ambiguous_stamps_give_a_warning() -> None:
    assert stamp_warnings(*[("/a", 0)] * 1200, ("/b", 5)) == ["/a: 1,200 images without a header stamp"]
    assert stamp_warnings(("/a", 5), ("/a", 5), ("/a", 5), ("/a", 6)) == [
        "/a: 2 images with the header stamp of the one before"
    ]
    assert stamp_warnings(("/b", 5), ("/b", 4), ("/a", 0), ("/b", 6)) == [
        "/a: 1 image without a header stamp",
        "/b: 1 image with a header stamp before that of the one before",
    ]


def test_frames_out_of_order_by_wrong_times_of_chunks_are_counted(tmp_path: Path) -> None:
    """A reader that relies on the times of chunks meets their messages too late."""
    to_write = [Shot(i, CAMERA, time_ns) for i, time_ns in enumerate(REGULAR)]
    path = make_recording(tmp_path / "a.mcap", to_write, index_types=factories.UNINDEXED)
    extents = open_recording(path).parts[0].layout.extents
    content = bytearray(path.read_bytes())
    for extent in extents[1::2]:
        content[extent.offset + 9 : extent.offset + 17] = (REGULAR[-1]).to_bytes(8, "little")
    path.write_bytes(content)
    frames = iter_frames(open_recording(path))
    assert sorted(frame.log_time_ns for frame in frames) == REGULAR
    warning = frames.warnings[0]  # another one is about the stamps
    assert "out of log-time order: the recording states wrong times of its chunks" in warning
