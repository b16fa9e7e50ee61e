"""Frames whose log times are far from all others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import factories
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording

from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.log_times import TimeRange
from inspect_pipeline.recording.reader import open_recording

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
