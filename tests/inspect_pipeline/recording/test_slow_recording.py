"""What takes minutes: a reader from another language, and memory on a large file."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import factories
import memory
import numpy as np
import pytest
from factories import CAMERA, START_NS, STEP_NS, make_recording, shots
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer

from inspect_pipeline.annotations.annotator import FrameAnnotator
from inspect_pipeline.recording.append import annotated_copy, sidecar
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from lsnet.segments import Detections, Lines, Segments

pytestmark = pytest.mark.slow

READ_WITH_NODE = """
import { open } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { decompress } from "fzstd";

const decompressHandlers = { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) };
const result = {};
for (const path of process.argv.slice(2)) {
  const file = await open(path, "r");
  const reader = await McapIndexedReader.Initialize({
    readable: new FileHandleReadable(file), decompressHandlers,
  });
  const messages = [];
  for await (const message of reader.readMessages()) {
    messages.push([reader.channelsById.get(message.channelId).topic, String(message.logTime)]);
  }
  const streamed = {};
  const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  stream.append(await file.readFile());
  for (let record; (record = stream.nextRecord()); ) streamed[record.type] = (streamed[record.type] ?? 0) + 1;
  const metadata = [];
  for await (const record of reader.readMetadata()) metadata.push(record.name);
  const count = String(reader.statistics.messageCount);
  result[path] = { messages, streamed, metadata, count, done: stream.done() };
  await file.close();
}
console.log(JSON.stringify(result));
"""


WRITE_WITH_NODE = """
import { open } from "node:fs/promises";
import { McapWriter } from "@mcap/core";
import { FileHandleWritable } from "@mcap/nodejs";

const { path, options, messages } = JSON.parse(process.argv[2]);
const file = await open(path, "w");
const writer = new McapWriter({ writable: new FileHandleWritable(file), ...options });
await writer.start({ profile: "", library: "test" });
const schemaId = await writer.registerSchema({
  name: "foxglove.CompressedImage", encoding: "jsonschema", data: new TextEncoder().encode("{}"),
});
const ids = {};
let sequence = 0;
for (const [topic, time, json] of messages) {
  ids[topic] ??= await writer.registerChannel({
    schemaId, topic, messageEncoding: "json", metadata: new Map(),
  });
  await writer.addMessage({
    channelId: ids[topic], sequence: sequence++, logTime: BigInt(time), publishTime: BigInt(time),
    data: new TextEncoder().encode(json),
  });
}
await writer.addMetadata({ name: "mission", metadata: new Map([["line", "7"]]) });
await writer.addAttachment({
  name: "a.txt", mediaType: "text/plain", data: new Uint8Array([1, 2, 3]), logTime: 1n, createTime: 1n,
});
await writer.end();
await file.close();
"""


@pytest.fixture(scope="module")
def node_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not (shutil.which("npm") and shutil.which("node")):
        pytest.skip("npm and node are not installed")
    folder = tmp_path_factory.mktemp("node")
    packages = ["@mcap/core", "@mcap/nodejs", "fzstd"]
    install = subprocess.run(["npm", "install", "--silent", *packages], cwd=folder, timeout=200, check=False)
    if install.returncode:
        pytest.skip("npm cannot install @mcap/core here")
    (folder / "read.mjs").write_text(READ_WITH_NODE)
    (folder / "write.mjs").write_text(WRITE_WITH_NODE)
    return folder


def annotate(source: Path, target: Path, write=annotated_copy) -> None:
    recording = open_recording(source)
    random = np.random.default_rng(0)
    with write(recording, target) as out:
        annotator = FrameAnnotator(out)
        for frame in iter_frames(recording):
            endpoints = random.uniform(0, 12, (frame.frame_idx % 5, 4)).astype(np.float32)
            segments = Segments(endpoints, random.random(len(endpoints), np.float32), (12, 16))
            annotator.write(frame, Detections(segments, Lines.empty((12, 16))))
        out.add_metadata("lsnet_pipe.run", {"flight_id": recording.flight_id})


def test_the_typescript_reader_agrees(node_folder: Path, tmp_path: Path) -> None:
    sources = {
        "zstd": {},
        "attachments": {"attachments": [b"a" * 5000], "metadata": {"mission": {"line": "7"}}},
        "truncated": {},
        "no_statistics": {"use_statistics": False, "repeat_channels": False},
    }
    targets = []
    for name, options in sources.items():
        source = make_recording(tmp_path / f"{name}.mcap", shots(60), **options)
        if name == "truncated":
            source.write_bytes(source.read_bytes()[:9000])
        targets.append(tmp_path / f"{name}_annotated.mcap")
        annotate(source, targets[-1])
    targets.append(tmp_path / "sidecar.mcap")
    annotate(tmp_path / "zstd.mcap", targets[-1], sidecar)

    command = ["node", str(node_folder / "read.mjs"), *map(str, targets)]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, timeout=100).stdout)
    for target in targets:
        with target.open("rb") as file:
            expected = [(c.topic, str(m.log_time)) for _, c, m in make_reader(file).iter_messages()]
        by_node = found[str(target)]
        assert Counter(map(tuple, by_node["messages"])) == Counter(expected)
        assert [time for _, time in by_node["messages"]] == [time for _, time in expected]
        assert int(by_node["count"]) == by_node["streamed"].get("Message", len(expected)) == len(expected)
        assert by_node["metadata"][-1] == "lsnet_pipe.run"
        assert by_node["done"]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"chunkSize": 2000},
        {"useChunks": False},
        {"useChunkIndex": False, "useMessageIndex": False},
        {"useStatistics": False, "repeatChannels": False, "repeatSchemas": False, "useSummaryOffsets": False},
    ],
)
def test_what_typescript_writes_is_read_and_annotated(
    node_folder: Path, tmp_path: Path, options: dict
) -> None:
    how, topics, path = factories.ENCODINGS["json"], (CAMERA, "/b/image"), tmp_path / "a.mcap"
    messages = [
        (topic, str(shot.log_time_ns), how.encode(shot.log_time_ns, "cam", image).decode())
        for shot in shots(20)
        for topic in topics
        for image in [factories.encoded_picture(shot.number)]
    ]
    job = json.dumps({"path": str(path), "options": options, "messages": messages})
    subprocess.run(["node", str(node_folder / "write.mjs"), job], check=True, timeout=60)
    recording = open_recording(path, strict=True)
    frames = list(iter_frames(recording))
    assert [(f.topic, factories.number_of(f.image)) for f in frames] == [
        (topic, i) for i in range(20) for topic in topics
    ]
    assert (recording.metadata, len(recording.parts[0].layout.attachments)) == ({"mission": {"line": "7"}}, 1)
    annotate(path, tmp_path / "b.mcap")
    with (tmp_path / "b.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == 40 + 2 * 40


MEASURE = """
import sys
from pathlib import Path
from memory import peak_kib
from inspect_pipeline.recording.append import annotated_copy
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

imported_kib = peak_kib()
source, target = Path(sys.argv[1]), Path(sys.argv[2])
recording = open_recording(source)
n_frames = 0
with annotated_copy(recording, target) as out:
    channel_id = out.add_channel(
        "/notes", schema_name="", schema_encoding="", schema_data=b"", message_encoding="json", metadata={}
    )
    for frame in iter_frames(recording):
        out.write(channel_id, frame.log_time_ns, frame.publish_time_ns, b"{}" * 500)
        n_frames += 1
print(n_frames, (peak_kib() - imported_kib) // 1024)
"""


@pytest.mark.parametrize(
    "options",
    [{}, {"index_types": IndexType.NONE, "use_statistics": False}, {"use_chunking": False}],
    ids=["indexed", "without summary", "unchunked"],
)
def test_memory_is_bounded_on_a_large_recording(tmp_path: Path, options: dict) -> None:
    """2 GB of images that barely decode: reading and writing back take less than 200 MB above the imports."""
    source, count, padding = tmp_path / "large.mcap", 2000, np.random.default_rng(0).bytes(1 << 20)
    how = factories.ENCODINGS["protobuf"]
    with source.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        schema_id = writer.register_schema(how.schema_name, how.schema_encoding, how.schema_data)
        channel_id = writer.register_channel(CAMERA, how.message_encoding, schema_id)
        for i in range(count):
            time_ns = START_NS + (i ^ 7) * STEP_NS  # out of order, chunks overlap
            payload = how.encode(time_ns, "cam", factories.encoded_picture(i) + padding[i:] + padding[:i])
            writer.add_message(channel_id, time_ns, payload, time_ns)
        writer.finish()
    assert source.stat().st_size > 2e9
    run = subprocess.run(
        [sys.executable, "-c", MEASURE, str(source), str(tmp_path / "annotated.mcap")],
        check=True,
        capture_output=True,
        timeout=250,
        env=os.environ | {"PYTHONPATH": str(Path(memory.__file__).parent)},
    )
    n_frames, memory_mb = map(int, run.stdout.split())
    assert n_frames == count
    assert memory_mb < 200
