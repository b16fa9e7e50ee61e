"""The store: a flight is visible whole or not at all, whatever happens to the process that writes it."""

from __future__ import annotations

import errno
import json
import os
import signal
from pathlib import Path

import duckdb
import flights
import numpy as np
import pytest
from memory import grows_by_less_than

from inspect_pipeline.errors import RecordingError, StoreBusyError, StoreError, StoreVersionError
from inspect_pipeline.index import publish as index
from inspect_pipeline.store.records import RESULT_VERSION
from inspect_pipeline.store.store import Store, store_path
from inspect_pipeline.tracking.tracker import TrackRow
from lsnet.segments import Detections, Lines, Segments


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "inspections")


def test_store_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LSNET_PIPE_STORE", raising=False)
    assert store_path(None) == Path("inspections")
    monkeypatch.setenv("LSNET_PIPE_STORE", "/elsewhere")
    assert store_path(None) == Path("/elsewhere")
    assert store_path(Path("/given")) == Path("/given")


def test_flight_dir_takes_only_a_hash(store: Store) -> None:
    assert store.flight_dir("0123456789abcdef" * 4) == store.root / "flights" / "0123456789abcdef"
    for wrong in ("../" * 22, "0" * 63, "Z" * 64):
        with pytest.raises(ValueError, match="not a flight_id"):
            store.flight_dir(wrong)


def test_written_flight(store: Store) -> None:
    flight_id = flights.write_flight(store, "a")
    folder = store.flight_dir(flight_id)
    result = json.loads((folder / "result.json").read_text())
    assert sorted(p.name for p in folder.iterdir()) == sorted(["result.json", *result["files"]])
    assert result["files"]["annotated.mcap"] == 100
    assert result["totals"]["n_frames"] == 3
    assert result["ingested_at"] == "2026-01-02T03:04:06.500000+00:00"
    loaded = store.load_flight(flight_id)
    assert loaded is not None
    assert loaded.run == flights.RUN
    assert loaded.channels[0].topic == flights.TOPIC
    assert store.load_flight("0" * 64) is None
    assert [p.name for p in (store.root / "staging").iterdir()] == ["mutex"]


def test_rows_of_a_flight(store: Store) -> None:
    folder = store.flight_dir(flights.write_flight(store, "a", 4))
    frames = duckdb.sql(
        "SELECT frame_idx, log_time_ns, stamp_ns, width, height, status, reason, sharpness, mean_luma,"
        f" n_segments, n_lines, infer_ms FROM '{folder}/frames.parquet'"
    ).fetchall()
    t = flights.START_NS
    assert frames == [
        (0, t, t - 7, 64, 48, "ok", None, 10.0, None, 0, 0, 2.0),
        (1, t + 10**8, t + 10**8 - 7, None, None, "bad", "corrupt JPEG", None, None, 0, 0, None),
        (2, t + 2 * 10**8, t + 2 * 10**8 - 7, 64, 48, "ok", None, 10.0, None, 2, 1, 4.0),
        (3, t + 3 * 10**8, t + 3 * 10**8 - 7, 64, 48, "ok", None, 10.0, None, 3, 1, 5.0),
    ]
    segments = duckdb.sql(
        f"SELECT frame_idx, seg_idx, x1, y1, x2, y2, score, length_px, round(angle_deg::DOUBLE, 3), line_idx"
        f" FROM '{folder}/segments.parquet'"
    ).fetchall()
    assert segments == [
        (frame_idx, i, i, 0.0, i + 3.0, 4.0, 0.5, 5.0, 53.13, None)
        for frame_idx, count in ((2, 2), (3, 3))
        for i in range(count)
    ]
    lines = duckdb.sql(
        "SELECT frame_idx, line_idx, n_points, points, x1, y1, x2, y2, score, length_px,"
        f" round(angle_deg::DOUBLE, 3) FROM '{folder}/lines.parquet'"
    ).fetchall()
    points = [{"x": 0.0, "y": 0.0}, {"x": 3.0, "y": 4.0}, {"x": 3.0, "y": 10.0}]
    assert lines == [(i, 0, 3, points, 0.0, 0.0, 3.0, 10.0, 0.75, 11.0, 73.301) for i in (2, 3)]


def test_segments_name_their_line(tmp_path: Path) -> None:
    found = flights.detections(3)
    owned = Detections(found.segments, found.lines, np.array([0, -1, 0], np.int32))
    with flights.FlightWriter(tmp_path, "f") as writer:
        writer.add_frame(flights.frame(0), owned)
        writer.add_frame(flights.frame(1), found)  # not known
        writer.finish()
    rows = duckdb.sql(f"SELECT line_idx FROM '{tmp_path}/segments.parquet'").fetchall()
    assert rows == [(0,), (None,), (0,), (None,), (None,), (None,)]


def test_lines_name_their_track(tmp_path: Path) -> None:
    """A track that was not confirmed leaves NULL, as does a frame whose lines were not tracked."""
    track = TrackRow(7, 0, 1, flights.START_NS, flights.START_NS + flights.PERIOD_NS, 2, 0, 0.5, 45.0, 1.0)
    found = flights.detections(1)
    with flights.FlightWriter(tmp_path, "f") as writer:
        for i, track_id in enumerate((7, 7, 8)):
            writer.add_frame(flights.frame(i), found, np.array([track_id], np.int32))
        writer.add_frame(flights.frame(3), found)
        writer.finish([(1, track)])
    rows = duckdb.sql(f"SELECT frame_idx, track_id FROM '{tmp_path}/lines.parquet'").fetchall()
    assert rows == [(0, 7), (1, 7), (2, None), (3, None)]
    assert duckdb.sql(f"SELECT track_id, n_frames FROM '{tmp_path}/tracks.parquet'").fetchall() == [(7, 2)]


def test_angles_are_below_180(tmp_path: Path) -> None:
    size = flights.IMAGE.shape[:2]
    ends = np.array([[0, 0, 9, -1e-7], [9, 0, 0, 0], [0, 0, 0, -5], [5, 5, 0, 0], [1, 1, 1, 1]], np.float32)
    found = Detections(Segments(ends, np.ones(5, np.float32), size), Lines.empty(size))
    with flights.FlightWriter(tmp_path, "f") as writer:
        writer.add_frame(flights.frame(0), found)
        writer.finish()
    angles = duckdb.sql(f"SELECT angle_deg FROM '{tmp_path}/segments.parquet'").fetchall()
    assert angles == [(0.0,), (0.0,), (90.0,), (45.0,), (0.0,)]


def test_a_frame_is_either_detected_or_bad(tmp_path: Path) -> None:
    with flights.FlightWriter(tmp_path, "f") as writer:
        with pytest.raises(ValueError, match="either"):
            writer.add_frame(flights.frame(0), None)
        with pytest.raises(ValueError, match="either"):
            writer.add_frame(flights.frame(0, "bad"), flights.detections(1))


def test_rows_beyond_one_flush_keep_their_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("inspect_pipeline.index.flight_tables._FLUSH_ROWS", 7)
    totals = flights.write_rows(tmp_path, "f", 12)
    assert (totals.n_frames, totals.n_bad_frames, totals.n_segments, totals.n_lines) == (12, 1, 65, 10)
    rows = duckdb.sql(f"SELECT frame_idx, seg_idx FROM '{tmp_path}/segments.parquet'").fetchall()
    assert rows == [(i, j) for i in range(12) if i != 1 for j in range(i)]
    lines = duckdb.sql(f"SELECT frame_idx, len(points) FROM '{tmp_path}/lines.parquet'").fetchall()
    assert lines == [(i, 3) for i in range(2, 12)]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_flight(store: Store) -> None:
    """Three million segments take under 200 MB and leave no spilled blocks."""
    flight_id = flights.flight_id_of("long")
    with grows_by_less_than(195):
        found = flights.detections(300)
        with (
            store.write_flight(flight_id) as staging,
            flights.FlightWriter(staging.path, flight_id) as writer,
        ):
            for i in range(10_000):
                writer.add_frame(flights.frame(i), found)
            staging.commit(flights.record("long", writer.finish()))
        index.publish(store)
    assert index.publish(store) == index.IndexChange(1, 0, 0, ())
    names = {path.name for path in store.flight_dir(flight_id).iterdir()}
    assert names == {
        "result.json",
        *(f"{name}.parquet" for name in ("frames", "segments", "lines", "tracks", "signals")),
    }


def test_reprocessing_replaces_the_folder(store: Store) -> None:
    flight_id = flights.write_flight(store, "a", 3)
    (store.flight_dir(flight_id) / "thumbnails").mkdir()
    flights.write_flight(store, "a", 2)
    assert not (store.flight_dir(flight_id) / "thumbnails").exists()
    loaded = store.load_flight(flight_id)
    assert loaded is not None
    assert loaded.totals.n_frames == 2


def test_a_failed_flight_leaves_nothing(store: Store) -> None:
    flights.write_flight(store, "a")
    with (
        pytest.raises(StoreError, match="Is a directory"),
        store.write_flight(flights.flight_id_of("a")) as staging,
    ):
        staging.path.write_bytes(b"half")
    with store.write_flight(flights.flight_id_of("b")):
        pass  # left without commit
    assert [p.name for p in (store.root / "staging").iterdir()] == ["mutex"]
    assert [f.record.source_uri for f in store.scan()[0]] == ["file:///inbox/a.mcap"]


def test_the_staging_of_a_live_process_is_left_alone(store: Store) -> None:
    ready, go = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        with store.write_flight(flights.flight_id_of("b")) as staging:
            os.write(ready[1], b"x")
            os.read(go[0], 1)
            totals = flights.write_rows(staging.path, flights.flight_id_of("b"), 2)
            staging.commit(flights.record("b", totals))
        os._exit(0)
    os.read(ready[0], 1)
    flights.write_flight(store, "a", 3)
    store.remove_leftovers()
    os.write(go[1], b"x")
    assert os.waitpid(child, 0)[1] == 0
    assert flights.versions(store) == {"a": 3, "b": 2}


def test_batch_lock_names_its_holder_and_ends_with_it(store: Store) -> None:
    ready = os.pipe()
    child = os.fork()
    if child == 0:
        with store.batch_lock():
            os.write(ready[1], b"x")
            signal.pause()
    os.read(ready[0], 1)
    with pytest.raises(StoreBusyError, match=f"pid {child} since") as caught, store.batch_lock():
        pass
    assert caught.value.exit_code == 11
    (store.root / "lock").write_bytes(b"\xff\xfe")  # torn by a power cut
    with pytest.raises(StoreBusyError, match="held by another batch; wait"), store.batch_lock():
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with store.batch_lock():
        assert f"pid {os.getpid()} " in (store.root / "lock").read_text()


def test_a_file_in_the_stores_place(tmp_path: Path) -> None:
    (tmp_path / "inspections").write_text("mine")
    store = Store(tmp_path / "inspections")
    for action in (
        lambda: flights.write_flight(store, "a"),
        lambda: index.publish(store),
        store.batch_lock().__enter__,
    ):
        with pytest.raises(StoreError, match="a file is where a folder should be; move it away"):
            action()


@pytest.mark.parametrize(
    ("code", "words"),
    [(errno.EROFS, "read-only"), (errno.EACCES, "permission denied"), (errno.EIO, "check the disk")],
)
def test_a_store_that_cannot_be_written(
    store: Store, monkeypatch: pytest.MonkeyPatch, code: int, words: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(StoreError, match=words) as caught:
        flights.write_flight(store, "a")
    assert "\n" not in str(caught.value)
    assert str(store.root) in str(caught.value)


@pytest.mark.parametrize(
    ("error", "raised", "text"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), StoreError, "no space left"),
        (OSError(errno.EIO, "Input/output error"), StoreError, "Input/output error; check the disk"),
        (RecordingError("a.mcap", "it cannot be read", "check the disk"), RecordingError, "a.mcap"),
    ],
)
def test_errors_of_the_disk_while_a_flight_is_written(
    store: Store, error: Exception, raised: type[Exception], text: str
) -> None:
    with pytest.raises(raised, match=text), store.write_flight(flights.flight_id_of("a")):
        raise error


def test_damaged_results_are_no_results(store: Store) -> None:
    flight_id = flights.write_flight(store, "a")
    result = store.flight_dir(flight_id) / "result.json"
    whole = result.read_text()
    for damaged in ("", "[]", "{}", whole[:100], whole.replace('"run_id"', '"nur_id"'), "null"):
        result.write_text(damaged)
        assert store.load_flight(flight_id) is None
        found, unreadable = store.scan()
        assert (found, [one.folder for one in unreadable]) == ([], [result.parent])
    later = f'"result_version": {RESULT_VERSION + 1}'
    result.write_text(whole.replace(f'"result_version": {RESULT_VERSION}', later))
    with pytest.raises(StoreVersionError, match="upgrade") as caught:
        store.load_flight(flight_id)
    assert caught.value.exit_code == 12


def test_manifest_lists_what_happened(store: Store) -> None:
    flights.write_flight(store, "a")
    index.publish(store)
    index.publish(store)
    lines = [json.loads(line) for line in (store.root / "manifest.jsonl").read_text().splitlines()]
    assert [line["event"] for line in lines] == ["flight", "publish"]
    assert lines[0]["flight_id"] == flights.flight_id_of("a")
