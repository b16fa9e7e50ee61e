"""Appending annotations to a recording of 1 GB on tmpfs: 10,000 messages of 8 segments, given serialised.

Against the mcap package reading and writing everything, and against a plain copy of the file, by
shutil.copyfile and by copy_file_range. Opening the recording counts, importing does not.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from large_recording import FRAME_STEP_NS, N_FRAMES, START_NS, write_large_recording
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from measure import alternate, conclude, measured, median_ratio, print_run, print_table

from inspect_pipeline.annotations.protobuf import encode_image_annotations, image_annotations_schema
from inspect_pipeline.recording.append import annotated_copy
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.types import Frame
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Iterable

TOPIC, SCHEMA = "/camera/image/compressed/lsnet/annotations", "foxglove.ImageAnnotations"
N_SEGMENTS = 8
N_ROUNDS, N_SLOW_ROUNDS = 9, 3
BARS = {
    "times_mcap_rewrite": (5.0, math.inf),
    "times_copyfile": (0.8, math.inf),
    "times_copy_file_range": (0.8, math.inf),
    "peak_mb": (0.0, 64.0),
}
TimedMessage = tuple[int, bytes]


def annotated(source: Path, target: Path, messages: Iterable[TimedMessage]) -> None:
    with annotated_copy(open_recording(source), target) as out:
        channel_id = out.add_channel(
            TOPIC,
            schema_name=SCHEMA,
            schema_encoding="protobuf",
            schema_data=image_annotations_schema(),
            message_encoding="protobuf",
            metadata={},
        )
        for time_ns, data in messages:
            out.write(channel_id, time_ns, time_ns, data)


def rewritten(source: Path, target: Path, messages: Iterable[TimedMessage]) -> None:
    with source.open("rb") as original, target.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        channel_ids: dict[int, int] = {}
        for schema, channel, message in make_reader(original).iter_messages():
            if channel.id not in channel_ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channel_ids[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            writer.add_message(channel_ids[channel.id], message.log_time, message.data, message.publish_time)
        schema_id = writer.register_schema(SCHEMA, "protobuf", image_annotations_schema())
        channel_id = writer.register_channel(TOPIC, "protobuf", schema_id)
        for time_ns, data in messages:
            writer.add_message(channel_id, time_ns, data, time_ns)
        writer.finish()


def copied(source: Path, target: Path, _: Iterable[TimedMessage]) -> None:
    shutil.copyfile(source, target)


def copied_in_kernel(source: Path, target: Path, _: Iterable[TimedMessage]) -> None:
    with source.open("rb") as original, target.open("wb") as file:
        while os.copy_file_range(original.fileno(), file.fileno(), 1 << 30):
            pass


METHODS = {
    "annotated_copy": annotated,
    "mcap rewrite": rewritten,
    "shutil.copyfile": copied,
    "copy_file_range": copied_in_kernel,
}
FAST = ("annotated_copy", "shutil.copyfile", "copy_file_range")


def make_messages() -> list[TimedMessage]:
    random = np.random.default_rng(1)
    times_ns = [START_NS + i * FRAME_STEP_NS for i in range(N_FRAMES)]
    return [(time_ns, _annotation(random, i, time_ns)) for i, time_ns in enumerate(times_ns)]


def _annotation(random: np.random.Generator, frame_idx: int, time_ns: int) -> bytes:
    frame = Frame(1, "/camera", frame_idx, time_ns, time_ns, time_ns, "cam", None)
    endpoints = random.uniform(0, 1000, (N_SEGMENTS, 4)).astype(np.float32)
    segments = Segments(endpoints, random.random(N_SEGMENTS, np.float32), (1080, 1920))
    return encode_image_annotations(frame, Detections(segments, Lines.empty((1080, 1920))))


def main() -> int:
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        source, target = Path(folder) / "source.mcap", Path(folder) / "target.mcap"
        write_large_recording(source)
        os.environ["BENCH_FOLDER"] = folder
        again = partial(target.unlink, missing_ok=True)
        runs = alternate(__file__, FAST, N_ROUNDS, prepare=again)
        slow_runs = alternate(__file__, ("annotated_copy", "mcap rewrite"), N_SLOW_ROUNDS, prepare=again)
    print_table(runs)
    print_table(slow_runs)
    figures = {
        "times_mcap_rewrite": median_ratio(slow_runs, "mcap rewrite", "annotated_copy"),
        "times_copyfile": median_ratio(runs, "shutil.copyfile", "annotated_copy"),
        "times_copy_file_range": median_ratio(runs, "copy_file_range", "annotated_copy"),
        "peak_mb": max(run.peak_bytes for run in runs["annotated_copy"]) / 2**20,
    }
    return conclude("append", figures, BARS)


def run_one(method: str) -> None:
    folder = Path(os.environ["BENCH_FOLDER"])
    work = partial(METHODS[method], folder / "source.mcap", folder / "target.mcap", make_messages())
    print_run(measured(work))


if __name__ == "__main__":
    sys.exit(run_one(sys.argv[1]) if len(sys.argv) > 1 else main())
