"""Memory of a whole `lsnet-pipe process`, with the real detector, on a recording of 2 GB."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import memory
import numpy as np
import pytest
from factories import CAMERA, ENCODINGS, START_NS, STEP_NS
from mcap.writer import Writer

SIZE = (3000, 4000)  # 12 megapixels, as inspection drones take them


MEASURE = """
import atexit, sys
from cli import main
from memory import peak_kib

atexit.register(lambda: print(peak_kib(), file=sys.stderr))
main()
"""


def write_large_recording(path: Path, n_bytes: int) -> int:
    """Write noisy photographs until the file has this size; the number of them."""
    random = np.random.default_rng(0)
    image = cv2.GaussianBlur(random.integers(0, 256, (*SIZE, 3), np.uint8), (0, 0), 1.0)
    jpeg, how = cv2.imencode(".jpg", image)[1].tobytes(), ENCODINGS["protobuf"]
    n_images = -(-n_bytes // len(jpeg))
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema_id = writer.register_schema(how.schema_name, how.schema_encoding, how.schema_data)
        channel_id = writer.register_channel(CAMERA, how.message_encoding, schema_id)
        for i in range(n_images):
            time_ns = START_NS + i * STEP_NS
            writer.add_message(channel_id, time_ns, how.encode(time_ns, "cam", jpeg), time_ns)
        writer.finish()
    return n_images


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_memory_stays_below_one_gibibyte(tmp_path: Path) -> None:
    n_images = write_large_recording(tmp_path / "large.mcap", 2_000_000_000)
    every = n_images // 24
    command = [sys.executable, "-c", MEASURE, "process", "large.mcap", "--json", "--every", str(every)]
    helpers = {"PYTHONPATH": str(Path(memory.__file__).parent)}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=True, env=os.environ | helpers)
    assert json.loads(done.stdout)["n_frames"] == -(-n_images // every)
    assert int(done.stderr.split()[-1]) < 1 << 20  # KiB
