"""How the mcap package may write a recording, and which pictures are read back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import factories
from factories import number_of
from mcap.writer import CompressionType

from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

WRITERS: dict[str, dict[str, Any]] = {  # options of factories.make_recording
    "mcap": {},
    "mcap none": {"compression": CompressionType.NONE},
    "mcap lz4": {"compression": CompressionType.LZ4},
    "one big chunk": {"chunk_size": 1 << 20},
    "json": {"encoding": "json"},
    "ros2": {"encoding": "ros2"},
    "unchunked": {"use_chunking": False},
    "unindexed": {"index_types": factories.UNINDEXED},
    "no chunk index": {"index_types": factories.NO_CHUNK_INDEX},
    "no message index": {"index_types": factories.NO_MESSAGE_INDEX},
    "no statistics": {"use_statistics": False},
    "no summary offsets": {"use_summary_offsets": False},
    "no repeated channels": {"repeat_channels": False},
    "no repeated schemas": {"repeat_schemas": False},
    "nothing repeated or counted": {
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "index_types": factories.UNINDEXED,
    },
    "no crcs": {"enable_crcs": False},
    "data crc": {"enable_data_crcs": True},
    "attachments and metadata": {"attachments": [b"a" * 5000, b""], "metadata": {"mission": {"line": "7"}}},
}


def numbers(path: Path, **options: Any) -> list[tuple[str, int, int]]:
    """(topic, frame_idx, picture) of each frame."""
    return [(f.topic, f.frame_idx, number_of(f.image)) for f in iter_frames(open_recording(path), **options)]
