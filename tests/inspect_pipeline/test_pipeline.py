"""One recording through the pipeline, with a detector whose answers are known."""

from __future__ import annotations

import json
import os
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import duckdb
import numpy as np
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording, shots
from fakes import FakeDetector
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.errors import RecordingError, StoreError
from inspect_pipeline.images.quality import measure_quality
from inspect_pipeline.index import publish as index
from inspect_pipeline.pipeline import Progress, process
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from inspect_pipeline.store.records import ProcessResult

ANNOTATIONS = ("detections", "annotations")  # what topics of ours end in


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "store")


def run(path: Path, store: Store, detector: Any = None, **options: Any) -> ProcessResult:
    detector, options = detector or FakeDetector(), ProcessOptions(**options)
    return process(path, store, detector, options, start_run(detector, options))


def rows(store: Store, sql: str) -> list[tuple[Any, ...]]:
    index.publish(store)
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return connection.execute(sql).fetchall()


def test_every_frame_has_its_row_and_its_annotation(tmp_path: Path, store: Store) -> None:
    """Picture i has i segments, at most three; the first has none."""
    result = run(make_recording(tmp_path / "a.mcap", shots(5)), store)
    assert (result.status, result.n_frames, result.n_bad_frames, result.n_segments) == ("ok", 5, 0, 9)
    assert rows(store, "SELECT frame_idx, n_segments, status FROM frames ORDER BY ALL") == [
        (i, min(i, 3), "ok") for i in range(5)
    ]
    assert rows(store, "SELECT x1, y1, x2, y2 FROM segments WHERE frame_idx = 1") == [(1, 0.5, 9, 4.5)]
    with result.annotated.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [list(reader.iter_decoded_messages([f"{CAMERA}/lsnet/{name}"])) for name in ANNOTATIONS]
    written, drawn = ([each.decoded_message for each in messages] for messages in found)
    assert [len(message.segments) for message in written] == [0, 1, 2, 3, 3]
    assert [len(message.points) for message in drawn] == [1] * 5  # without points: there are no lines


def test_the_annotated_copy_says_how_it_was_made(tmp_path: Path, store: Store) -> None:
    result = run(make_recording(tmp_path / "a.mcap", shots(1)), store, every=1)
    with result.annotated.open("rb") as file:
        metadata = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    said = metadata["lsnet_pipe.run"]
    assert said["flight_id"] == result.flight_id
    assert said["weights_sha256"] == "ab" * 32
    assert json.loads(said["config"])["detector"]["backend"] == "fake"


def test_a_bad_image_is_a_bad_frame(tmp_path: Path, store: Store) -> None:
    broken = Shot(1, log_time_ns=START_NS + STEP_NS, data=b"\xff\xd8\xffnothing")
    path = make_recording(tmp_path / "a.mcap", [Shot(2), broken, Shot(3, log_time_ns=START_NS + 2 * STEP_NS)])
    result = run(path, store)
    assert (result.status, result.n_frames, result.n_bad_frames, result.n_segments) == ("ok", 3, 1, 5)
    assert "1 of 3 frames cannot be decoded" in result.warnings[0]
    ((status, reason, sharpness),) = rows(
        store, "SELECT status, reason, sharpness FROM frames WHERE frame_idx = 1"
    )
    assert (status, sharpness) == ("bad", None)
    assert "not of a format" in reason


def test_a_damaged_image_is_doubtful(tmp_path: Path, store: Store) -> None:
    """It is processed, with the reason, and is not a bad frame."""
    rng = np.random.default_rng(3)
    damaged = bytearray(cv2.imencode(".jpg", rng.integers(0, 255, (120, 160, 3), np.uint8))[1].tobytes())
    for at in rng.integers(len(damaged) // 2, len(damaged) - 10, 20):
        damaged[at] ^= 0x55
    to_write = [Shot(2), Shot(1, log_time_ns=START_NS + STEP_NS, data=bytes(damaged))]
    result = run(make_recording(tmp_path / "a.mcap", to_write), store)
    assert (result.status, result.n_frames, result.n_bad_frames) == ("ok", 2, 0)
    found = rows(store, "SELECT status, reason, width, n_segments > 0 FROM frames ORDER BY frame_idx")
    assert found[0][:2] == ("ok", None)
    assert (found[1][0], found[1][2:]) == ("doubtful", (160, True))
    assert "damaged: Corrupt JPEG data" in found[1][1]


def test_done_is_not_done_again(tmp_path: Path, store: Store) -> None:
    """Under another name the same recording is the same flight."""
    path = make_recording(tmp_path / "a.mcap", shots(2))
    first = run(path, store)
    detector = FakeDetector()
    again = run(path.rename(tmp_path / "b.mcap"), store, detector)
    assert (again.status, again.flight_id, again.n_segments) == ("skipped", first.flight_id, first.n_segments)
    assert detector.batch_sizes == []


def test_two_processes_of_one_recording_do_the_work_once(tmp_path: Path, store: Store) -> None:
    path = make_recording(tmp_path / "r.mcap", shots(5))
    detectors = [FakeDetector(), FakeDetector()]
    waits: list[str] = []
    with ThreadPoolExecutor(2) as pool, store.lock_flight(open_recording(path).flight_id):
        futures = [
            pool.submit(process, path, store, detector, on_wait=lambda: waits.append("waits"))
            for detector in detectors
        ]
        time.sleep(0.3)
        assert not any(future.done() for future in futures)  # both wait for this thread's lock
    assert sorted(future.result().status for future in futures) == ["ok", "skipped"]
    assert sorted(sum(detector.batch_sizes) for detector in detectors) == [0, 5]
    assert waits == ["waits", "waits"]
    assert [each.name for each in (store.root / "staging").iterdir()] == ["mutex"]


@pytest.mark.parametrize(
    ("detector", "options"),
    [
        (FakeDetector(), {"force": True}),
        (FakeDetector(min_score=0.7), {}),
        (FakeDetector(weights="other"), {}),
        (FakeDetector(), {"every": 2}),
    ],
)
def test_another_model_or_config_replaces(
    tmp_path: Path, store: Store, detector: FakeDetector, options: dict[str, Any]
) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(4))
    run(path, store)
    result = run(path, store, detector, **options)
    assert result.status == "ok"
    assert rows(store, "SELECT count(*) FROM frames") == [(result.n_frames,)]
    assert rows(store, "SELECT count(*) FROM flights") == [(1,)]


def test_a_camera_without_one_good_frame_is_a_failure(tmp_path: Path, store: Store) -> None:
    """The other camera's frames are kept."""
    images = (b"\xff\xd8\xffnothing", b"\xff\xd8\xffnothing", b"")
    bad = [Shot(1, "/rear", START_NS + i * STEP_NS, data=data) for i, data in enumerate(images)]
    result = run(make_recording(tmp_path / "a.mcap", [*shots(2), *bad]), store)
    assert (result.status, result.n_frames, result.n_bad_frames) == ("failed", 5, 3)
    assert result.reason.startswith("/rear: 3 of 3 frames cannot be decoded: ")
    assert result.reason.endswith(" (2 times)")
    assert rows(store, "SELECT status, count(*) FROM frames GROUP BY 1 ORDER BY 1") == [("bad", 3), ("ok", 2)]


def test_no_detector_and_no_run_are_the_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lsnet.Detector", FakeDetector)
    path = make_recording(tmp_path / "a.mcap", shots(2))
    assert process(str(path), str(tmp_path / "store")).status == "ok"
    assert process(path, tmp_path / "store").status == "skipped"


def test_a_damaged_result_is_made_again(tmp_path: Path, store: Store) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(2))
    os.truncate(run(path, store).annotated, 100)
    assert run(path, store).status == "ok"
    assert run(path, store).status == "skipped"


def test_an_annotated_copy_is_skipped(tmp_path: Path, store: Store) -> None:
    first = run(make_recording(tmp_path / "a.mcap", shots(2)), store)
    again = run(first.annotated, store)
    assert (again.status, again.flight_id, again.n_frames) == ("skipped", first.flight_id, 0)


def test_a_selection_of_frames(tmp_path: Path, store: Store) -> None:
    path = make_recording(tmp_path / "a.mcap", [*shots(6), *shots(6, "/other")])
    run(path, store, topics=(CAMERA,), every=2, start_ns=START_NS + STEP_NS, end_ns=START_NS + 5 * STEP_NS)
    assert rows(store, "SELECT frame_idx, topic FROM frames JOIN channels USING (channel_id)") == [
        (2, CAMERA),
        (4, CAMERA),
    ]


def test_damage_is_refused_or_survived(tmp_path: Path, store: Store) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(40))
    os.truncate(path, path.stat().st_size * 2 // 3)
    with pytest.raises(RecordingError, match="the part that can be read"):
        run(path, store, strict=True)
    result = run(path, store)
    assert result.status == "recovered"
    assert 0 < result.n_frames < 40
    ((reason,),) = rows(store, "SELECT reason FROM flights")
    assert "lost" in reason


def test_a_failure_leaves_nothing(tmp_path: Path, store: Store) -> None:
    class Failing(FakeDetector):
        def detect(self, images: Any, **_: object) -> Any:
            raise KeyboardInterrupt

    path = make_recording(tmp_path / "a.mcap", shots(20))
    with pytest.raises(KeyboardInterrupt):
        run(path, store, Failing())
    assert list((store.root / "flights").iterdir()) == []
    assert [p.name for p in (store.root / "staging").iterdir()] == ["mutex"]
    assert run(path, store).n_frames == 20


def test_the_store_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "store").write_text("not a folder")
    with pytest.raises(StoreError, match="a file is where a folder should be"):
        run(make_recording(tmp_path / "a.mcap", shots(1)), Store(tmp_path / "store"))


def test_batches_are_small_and_progress_is_reported(tmp_path: Path, store: Store) -> None:
    path, detector, reports = make_recording(tmp_path / "a.mcap", shots(20)), FakeDetector(), []
    options = ProcessOptions()
    process(path, store, detector, options, start_run(detector, options), on_progress=reports.append)
    assert sum(detector.batch_sizes) == 20
    assert max(detector.batch_sizes) <= 4
    assert reports[-1] == Progress(20, 20)
    assert all(a.n_frames < b.n_frames for a, b in pairwise(reports))


@pytest.mark.parametrize(
    ("name", "n_frames"),
    [
        ("brighton_ros2", 18),
        ("caliterra_foxglove", 40),
        ("lichtblick_custom_camera_model", 10),
        ("pldm_frames", 25),
        ("pldu_frames", 57),
    ],
)
def test_real_recordings(data_dir: Path, store: Store, name: str, n_frames: int) -> None:
    """Every fourth frame of them, to save time; every message is copied."""
    result = run(data_dir / "mcap" / f"{name}.mcap", store, every=4)
    n_taken = -(-n_frames // 4)
    assert (result.status, result.n_frames, result.n_bad_frames) == ("ok", n_taken, 0)
    assert rows(store, "SELECT count(*), max(frame_idx), min(width) > 0, min(sharpness) > 0 FROM frames") == [
        (n_taken, 4 * (n_taken - 1), True, True)
    ]
    with result.annotated.open("rb") as file:
        counts = make_reader(file, validate_crcs=True).get_summary().statistics.channel_message_counts
    assert n_frames in counts.values()  # the images
    assert list(counts.values()).count(n_taken) >= 2  # our two channels


def test_quality_of_known_pictures() -> None:
    """A checkerboard of 0 and 255: each Laplacian is 4 * 255 up or down."""
    board = (np.indices((8, 8)).sum(axis=0) % 2 * 255).astype(np.uint8)
    sharp = measure_quality(np.repeat(board[..., np.newaxis], 3, axis=2))
    assert sharp.mean_luma == 127.5
    assert sharp.sharpness == pytest.approx((4 * 255) ** 2)
    grey = measure_quality(np.full((3000, 2000, 3), 90, np.uint8))
    assert (grey.sharpness, grey.mean_luma) == (0, 90)


@pytest.mark.parametrize("size", [(1, 4096), (60_000, 2)])
def test_quality_of_the_pictures_of_a_line_camera(size: tuple[int, int]) -> None:
    assert measure_quality(np.full((*size, 3), 90, np.uint8)).mean_luma == 90
