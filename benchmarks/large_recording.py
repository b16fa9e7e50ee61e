"""A recording of 1 GB, written by the mcap package alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from mcap.writer import CompressionType, Writer

if TYPE_CHECKING:
    from pathlib import Path

START_NS = 1_700_000_000_000_000_000
FRAME_STEP_NS = 100_000_000
N_FRAMES = 10_000
IMAGE_BYTES = 100_000
N_FIXES_PER_FRAME = 10


def write_large_recording(path: Path) -> None:
    """Images that compress no further, as JPEGs do not, with positions between them; zstd, 1 MiB chunks."""
    random = np.random.default_rng(0)
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        image_schema_id = writer.register_schema("sensor_msgs/msg/CompressedImage", "ros2msg", b"")
        image_id = writer.register_channel("/camera/image/compressed", "cdr", image_schema_id)
        fix_schema_id = writer.register_schema("sensor_msgs/msg/NavSatFix", "ros2msg", b"")
        fix_id = writer.register_channel("/gps", "cdr", fix_schema_id)
        for i in range(N_FRAMES):
            time_ns = START_NS + i * FRAME_STEP_NS
            writer.add_message(image_id, time_ns, random.bytes(IMAGE_BYTES), time_ns)
            for j in range(N_FIXES_PER_FRAME):
                fix_ns = time_ns + j * FRAME_STEP_NS // N_FIXES_PER_FRAME
                writer.add_message(fix_id, fix_ns, bytes(100) + fix_ns.to_bytes(8, "little"), fix_ns)
        writer.finish()
