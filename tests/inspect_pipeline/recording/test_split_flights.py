"""Split recordings, processed where they lie."""

from __future__ import annotations

import hashlib
import os
import shutil
from typing import TYPE_CHECKING, Any

import pytest
from factories import CAMERA, START_NS, STEP_NS, make_recording, make_recording_with_rosbags, number_of, shots
from fakes import FakeDetector
from mcap.reader import make_reader
from stubs import InlineExecutor, MakeStub

from inspect_pipeline.batch.options import BatchOptions
from inspect_pipeline.batch.run import run_batch
from inspect_pipeline.batch.worker import Job
from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.index import publish as index
from inspect_pipeline.overlay import draw_overlays, select_frames
from inspect_pipeline.pipeline import process
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.records import ProcessResult

OTHER = "/left/image/compressed"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """Three parts of four pictures; the second numbers its channels another way."""
    folder = tmp_path / "flight"
    folder.mkdir()
    for i, topics in enumerate([(CAMERA, OTHER), (OTHER, CAMERA), (CAMERA, OTHER)]):
        pictures = [shot for topic in topics for shot in shots(4 * i + 4, topic)[4 * i :]]
        make_recording(folder / f"x_{i + 9}.mcap", pictures)
    return folder


def run(path: Path, store: Store, **options: Any) -> ProcessResult:
    detector, asked = FakeDetector(), ProcessOptions(**options)
    return process(path, store, detector, asked, start_run(detector, asked))


def test_numbered_parts_are_one_flight(flight: Path, store: Store) -> None:
    before = {path: path.read_bytes() for path in flight.iterdir()}
    result = run(flight, store, topics=(CAMERA,))
    sums = [hashlib.sha256(before[flight / f"x_{i}.mcap"]).hexdigest() for i in (9, 10, 11)]
    assert result.flight_id == hashlib.sha256("".join(f"{each}\n" for each in sums).encode()).hexdigest()
    assert (result.status, result.n_frames, result.source) == ("ok", 12, str(flight))
    assert {path: path.read_bytes() for path in flight.iterdir()} == before

    copy = open_recording(result.annotated)
    assert copy.flight_id == result.flight_id
    frames = list(iter_frames(copy, copy.select_cameras([CAMERA])))
    assert [(frame.frame_idx, number_of(frame.image)) for frame in frames] == [(i, i) for i in range(12)]
    with result.annotated.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages([f"{CAMERA}/lsnet/annotations"]))
    assert [message.log_time for *_, message in found] == [frame.log_time_ns for frame in frames]

    record = store.load_flight(result.flight_id)
    assert record.source_uri == flight.as_uri()
    assert record.source_bytes == sum(map(len, before.values()))
    assert [name for name in record.files if name.endswith(".mcap")] == ["annotated.mcap"]
    assert run(flight, store, topics=(CAMERA,)).status == "skipped"


@pytest.mark.parametrize("write", ["sidecar", "none"])
def test_only_annotations_of_a_split_recording_are_written(flight: Path, store: Store, write: str) -> None:
    result = run(flight, store, write=write)
    folder = store.flight_dir(result.flight_id)
    assert [path.name for path in folder.glob("*.mcap")] == (
        ["annotations.mcap"] if write == "sidecar" else []
    )
    index.publish(store)
    drawn = next(draw_overlays(store, result.flight_id, select_frames(store, result.flight_id, 5)))
    assert (drawn.frame_idx, drawn.image.shape[1]) == (5, 16)


def test_a_rosbag2_is_one_flight(tmp_path: Path, store: Store) -> None:
    """With one file in it, it is the flight that its file is."""
    bag = tmp_path / "bag"
    path = make_recording_with_rosbags(bag, shots(4))
    assert open_recording(bag).flight_id == open_recording(path).flight_id
    assert run(bag, store).n_frames == 4
    assert run(path, store).status == "skipped"

    second = make_recording_with_rosbags(tmp_path / "more", shots(4, start_ns=START_NS + 4 * STEP_NS))
    shutil.copy(second, bag / "z.mcap")
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text.replace(f"- {path.name}\n", f"- {path.name}\n    - z.mcap\n", 1))
    result = run(bag, store)
    assert (result.status, result.n_frames) == ("ok", 8)


def test_a_batch_takes_a_split_rosbag2_as_one(
    tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("inspect_pipeline.batch.options.LocalExecutor", InlineExecutor)
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    path = make_recording_with_rosbags(inbox / "bag", shots(4))
    other = make_recording_with_rosbags(tmp_path / "more", shots(4, start_ns=START_NS + 4 * STEP_NS))
    shutil.copy(other, inbox / "bag" / "z.mcap")
    index_file = inbox / "bag" / "metadata.yaml"
    index_file.write_text(
        index_file.read_text().replace(f"- {path.name}\n", f"- {path.name}\n    - z.mcap\n", 1)
    )
    job = Job(store.root, ProcessOptions(), MakeStub(tmp_path))
    for n_processed, n_skipped in ((1, 0), (0, 1)):
        summary = run_batch(store, job, BatchOptions((str(inbox),), settle_s=0), lambda event, **fields: None)
        counts = summary.counts
        assert (summary.exit_code, counts.n_found, counts.n_processed, counts.n_skipped) == (
            0,
            1,
            n_processed,
            n_skipped,
        )
    (flight,), _ = store.scan()
    assert (flight.record.totals.n_frames, flight.record.source_uri) == (8, (inbox / "bag").as_uri())


def test_the_reason_names_the_damaged_part(flight: Path, store: Store) -> None:
    part = flight / "x_11.mcap"
    part.write_bytes(part.read_bytes()[:-1500])
    with pytest.raises(RecordingError, match=r"x_11\.mcap: "):
        run(flight, store, strict=True)
    result = run(flight, store)
    assert result.status == "recovered"
    assert result.reason.startswith("x_11.mcap: ")
    assert 16 <= result.n_frames < 24


def test_a_missing_part_gives_a_warning(flight: Path) -> None:
    assert open_recording(flight).warnings == []
    (flight / "x_10.mcap").unlink()
    (flight / "x_11.mcap").rename(flight / "x_12.mcap")
    (warning,) = open_recording(flight).warnings
    assert warning == "parts between the first and the last are missing: 10, 11"


def test_other_folders_are_refused(tmp_path: Path, store: Store) -> None:
    (tmp_path / "photographs").mkdir()
    with pytest.raises(RecordingError, match=r"photographs: the folder has no recording; .*lsnet-pipe pack"):
        run(tmp_path / "photographs", store)
    folder = tmp_path / "gps"
    folder.mkdir()
    for i in range(2):
        make_recording(folder / f"g_{i}.mcap", [])
    with pytest.raises(RecordingError) as caught:
        run(folder, store)
    assert (caught.value.path, caught.value.problem) == (folder, "no camera topic")
    assert not list(store.root.rglob("*.mcap"))


def test_a_part_that_carries_annotations_is_refused(flight: Path, store: Store) -> None:
    shutil.copy(run(flight / "x_9.mcap", store).annotated, flight / "x_9.mcap")
    with pytest.raises(RecordingError, match=r"x_9\.mcap: it carries annotations already"):
        run(flight, store)


def test_a_picture_of_a_recording_whose_name_is_not_utf8(tmp_path: Path, store: Store) -> None:
    path = make_recording(tmp_path / os.fsdecode(b"caf\xe9 %20.mcap"), shots(1))
    options = ProcessOptions(write="none")
    result = process(path, store, FakeDetector(), options, start_run(FakeDetector(), options))
    index.publish(store)
    first, *_ = select_frames(store, result.flight_id)
    assert next(draw_overlays(store, result.flight_id, [first])).frame_idx == 0
