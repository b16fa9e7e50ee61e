"""The index: what the flights say, whatever was done to it, and always whole for its readers."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import duckdb
import flights
import pytest

from inspect_pipeline.errors import StoreError, StoreVersionError
from inspect_pipeline.index import publish as index
from inspect_pipeline.index import schema
from inspect_pipeline.index.named_queries import find_query
from inspect_pipeline.index.verify import verify
from inspect_pipeline.inspection.spans import Span, import_spans
from inspect_pipeline.resources import MIGRATIONS, read_schema
from inspect_pipeline.store.feedback import add_tag
from inspect_pipeline.store.runs import save_run, summarize_process
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.records import RunRecord

TABLES = ("models", "runs", "flights", "channels", "frames", "segments", "lines")
DERIVED = ("coverage", "coverage_bins", "coverage_gaps", "conductor_counts", "anomalies", "inputs")
VIEWS = ("flight_summary", "bad_frames", "frame_dropouts", "detection_gaps", "span_last_seen")


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("template"))
    flights.write_flight(store, "a", 3)
    flights.write_flight(store, "b", 4)
    index.publish(store)
    return store


@pytest.fixture
def store(tmp_path: Path, template: Store) -> Store:
    """A published store of the flights a (3 frames) and b (4 frames)."""
    return Store(shutil.copytree(template.root, tmp_path / "inspections"))


def ask(store: Store, sql: str) -> list[tuple[Any, ...]]:
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return connection.execute(sql).fetchall()


def content(store: Store) -> dict[str, list[tuple[Any, ...]]]:
    """Everything in the index, in an order that does not depend on it."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return {
            name: sorted(connection.execute(f"FROM {name}").fetchall(), key=repr)
            for name in (*TABLES, *DERIVED, *VIEWS)
        }


def test_published_rows(store: Store) -> None:
    a, b = flights.flight_id_of("a"), flights.flight_id_of("b")
    assert ask(
        store, "SELECT flight_id, n_frames, n_bad_frames, n_segments, n_lines FROM flights ORDER BY ALL"
    ) == [*sorted([(a, 3, 1, 2, 1), (b, 4, 1, 5, 2)])]
    assert ask(store, f"SELECT frame_idx, status, n_segments FROM frames WHERE flight_id = '{b}'") == [
        (0, "ok", 0),
        (1, "bad", 0),
        (2, "ok", 2),
        (3, "ok", 3),
    ]
    assert ask(store, "SELECT count(*), sum(x2 - x1), max(angle_deg) < 180 FROM segments") == [
        (7, 21.0, True)
    ]
    assert ask(store, "SELECT model_id, score_threshold FROM models") == [("fast-1", 0.5)]
    assert ask(store, "SELECT run_id::VARCHAR, started_at::VARCHAR, config->>'every' FROM runs") == [
        (flights.RUN.run_id, "2026-01-02 03:04:05", "1")
    ]


def test_times_stand_beside_their_nanoseconds(store: Store) -> None:
    columns = "log_time_ns, log_time_utc::VARCHAR, stamp_utc::VARCHAR"
    assert ask(store, f"SELECT DISTINCT {columns} FROM frames WHERE frame_idx = 2") == [
        (flights.START_NS + 200_000_000, "2023-11-14 22:13:20.323456", "2023-11-14 22:13:20.323456")
    ]
    assert ask(store, "SELECT DISTINCT first_ns, last_utc::VARCHAR FROM channels ORDER BY ALL") == [
        (flights.START_NS, "2023-11-14 22:13:20.323456"),
        (flights.START_NS, "2023-11-14 22:13:20.423456"),
    ]
    assert ask(store, "SELECT count(*) FROM flights WHERE ingested_at = '2026-01-02 03:04:06.5'") == [(2,)]


def test_publish_replaces_adds_and_removes(store: Store) -> None:
    a = flights.write_flight(store, "a", 2)
    c = flights.write_flight(store, "c", 1)
    shutil.rmtree(store.flight_dir(flights.flight_id_of("b")))
    assert index.publish(store) == index.IndexChange(2, 2, 1, ())
    assert sorted(ask(store, "SELECT flight_id, count(*) FROM frames GROUP BY ALL")) == sorted(
        [(a, 2), (c, 1)]
    )
    assert ask(store, "SELECT count(*) FROM segments") == [(0,)]
    assert ask(store, "SELECT count(*) FROM models") == [(1,)]
    assert verify(store) == ()


def test_publishing_nothing_new_writes_nothing(store: Store) -> None:
    before = store.index_path.stat().st_ino
    assert index.publish(store) == index.IndexChange(2, 0, 0, ())
    assert store.index_path.stat().st_ino == before


def test_an_empty_flight_and_an_empty_store(tmp_path: Path) -> None:
    store = Store(tmp_path)
    assert index.publish(store) == index.IndexChange(0, 0, 0, ())
    assert ask(store, "SELECT count(*) FROM flight_summary") == [(0,)]
    flights.write_flight(store, "nothing", 0)
    index.publish(store)
    assert ask(
        store,
        "SELECT n_frames, start_ns, duration_s, detection_share FROM flight_summary JOIN flights USING"
        " (flight_id, n_frames)",
    ) == [(0, None, None, None)]
    assert verify(store) == ()


def test_rebuild_gives_the_same_answers(store: Store) -> None:
    assert verify(store) == ()
    flights.write_flight(store, "a", 5)
    index.publish(store)
    before = content(store)
    assert all(before[name] for name in TABLES)
    store.index_path.unlink()
    index.rebuild(store)
    assert content(store) == before


@pytest.fixture(scope="module")
def content_with_c(
    template: Store, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[tuple[Any, ...]]]:
    """What an index says that nobody damaged, after another flight."""
    store = Store(shutil.copytree(template.root, tmp_path_factory.mktemp("whole") / "inspections"))
    flights.write_flight(store, "c", 1)
    index.publish(store)
    return content(store)


@pytest.mark.parametrize("damage", ["deleted", "garbage", "no tables", "a table lost", "flipped", "cut"])
def test_a_lost_index_is_made_anew_at_the_next_publish(
    store: Store, damage: str, content_with_c: dict[str, list[tuple[Any, ...]]]
) -> None:
    path = store.index_path
    whole = path.read_bytes()
    if damage == "a table lost":
        with duckdb.connect(path) as connection:
            connection.execute("DROP TABLE inputs")
    else:
        path.unlink()
    if damage == "garbage":
        path.write_bytes(b"not a database" * 1000)
    elif damage == "no tables":
        duckdb.connect(path).close()
    elif damage == "flipped":
        path.write_bytes(bytes(b ^ 0xFF if i % 1000 == 0 and i > 12288 else b for i, b in enumerate(whole)))
    elif damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    assert damage == "flipped" or verify(store)
    flights.write_flight(store, "c", 1)
    index.publish(store)
    assert content(store) == content_with_c


def test_a_log_that_someone_left_is_not_replayed(store: Store) -> None:
    before = content(store)
    child = os.fork()
    if child == 0:
        connection = duckdb.connect(store.index_path)
        connection.execute("DELETE FROM segments")
        os._exit(0)  # leaves index.duckdb.wal
    os.waitpid(child, 0)
    assert list(store.root.glob("index.duckdb.wal"))
    assert any("segments" in problem for problem in verify(store))
    index.rebuild(store)
    assert not list(store.root.glob("index.duckdb.wal"))
    assert content(store) == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("DELETE FROM flights WHERE source_uri LIKE '%/a.mcap'", "not in the index"),
        ("UPDATE flights SET flight_id = 'f' || flight_id", "in the index"),
        ("UPDATE flights SET result_sha256 = 'x' WHERE source_uri LIKE '%/a.mcap'", "older in the index"),
        ("DELETE FROM frames WHERE frame_idx = 2", "frames in the index differ"),
        ("INSERT INTO segments BY NAME SELECT * FROM segments LIMIT 1", "segments in the index differ"),
        ("UPDATE lines SET score = 0.7 WHERE frame_idx = 3", "lines in the index differ"),
    ],
)
def test_verify_finds_any_difference(store: Store, change: str, words: str) -> None:
    with duckdb.connect(store.index_path) as connection:
        connection.execute(change)
    problems = verify(store)
    assert problems
    assert all(words in problem for problem in problems)


def test_a_damaged_flight_is_reported_and_left_out(store: Store) -> None:
    folder = store.flight_dir(flights.flight_id_of("a"))
    (folder / "segments.parquet").write_bytes(b"cut")
    assert any("segments.parquet has another size" in problem for problem in verify(store))
    change = index.publish(store)
    assert [one.folder for one in change.damaged] == [folder]
    assert "segments.parquet has another size; process its recording again" in change.damaged[0].problem
    assert ask(store, "SELECT count(*) FROM flights") == [(1,)]
    assert index.publish(store) == index.IndexChange(1, 0, 0, change.damaged)
    flights.write_flight(store, "a", 3)
    index.publish(store)
    assert verify(store) == ()


def test_a_flight_with_flipped_bits_is_left_out(store: Store) -> None:
    folder = store.flight_dir(flights.flight_id_of("a"))
    path = folder / "segments.parquet"
    path.write_bytes(b"\xff" * path.stat().st_size)
    problem = "the checksum of segments.parquet differs; process its recording again"
    assert verify(store) == (f"{folder}: {problem}",)
    change = index.rebuild(store)
    assert [one.folder for one in change.damaged] == [folder]
    assert ask(store, "SELECT count(*) FROM flights") == [(1,)]


@pytest.mark.parametrize("table", ["frames", "segments", "lines", "tracks"])
@pytest.mark.parametrize("has_checksums", [True, False])
def test_one_flipped_byte_costs_one_flight(store: Store, table: str, has_checksums: bool) -> None:
    """Whichever file it is in; a flight of before checksums were kept is left out where DuckDB notices."""
    folder = store.flight_dir(flights.flight_id_of("a"))
    path = folder / f"{table}.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    if has_checksums:
        assert verify(store) == (
            f"{folder}: the checksum of {path.name} differs; process its recording again",
        )
        assert store.load_flight(flights.flight_id_of("a")) is None
        assert [one.folder for one in index.rebuild(store).damaged] == [folder]
        assert set(flights.versions_in_index(store)) == {"b"}
        assert len(verify(store)) == 1
    else:
        result = json.loads((folder / "result.json").read_text())
        del result["sha256"]
        (folder / "result.json").write_text(json.dumps(result))
        index.rebuild(store)
        assert "b" in flights.versions_in_index(store)


def test_a_result_of_wrong_types_costs_one_flight(store: Store) -> None:
    result = store.flight_dir(flights.flight_id_of("a")) / "result.json"
    for field, value in (("totals", {"n_frames": "many"}), ("channels", [{"channel_id": "x"}]), ("model", 5)):
        whole = json.loads(result.read_text())
        part = whole[field]
        changed = part | value if isinstance(part, dict) and isinstance(value, dict) else value
        if field == "channels":
            changed = [part[0] | {"channel_id": "x"}]
        result.write_text(json.dumps(whole | {field: changed}))
        assert [one.folder for one in index.rebuild(store).damaged] == [result.parent]
        assert set(flights.versions_in_index(store)) == {"b"}
        result.write_text(json.dumps(whole))


def test_a_damaged_annotated_copy_is_found(store: Store) -> None:
    path = store.flight_dir(flights.flight_id_of("a")) / "annotated.mcap"
    path.write_bytes(b"x" + path.read_bytes()[1:])
    assert verify(store) == (
        f"{path.parent}: the checksum of annotated.mcap differs; process its recording again with --force",
    )
    assert index.rebuild(store).damaged == ()  # its rows are whole


def test_a_copied_folder_counts_once(store: Store) -> None:
    folder = store.flight_dir(flights.flight_id_of("a"))
    before = content(store)
    shutil.copytree(folder, folder.with_name("backup"))
    (folder.parent / ".DS_Store").touch()
    (damage,) = index.rebuild(store).damaged
    assert damage.folder == folder.with_name("backup")
    assert damage.problem.startswith(f"a copy of flight {folder.name} under another name; remove it")
    assert content(store) == before
    assert len(verify(store)) == 1


def test_a_rebuild_after_idle_nights_is_not_needed(store: Store) -> None:
    """DuckDB 2 trims free blocks at the end of the file: its size says nothing about its content."""
    for night in range(3):
        save_run(store, summarize_process(_run(night), [], n_found=0, n_failed=0, exit_code=0))
        assert index.publish(store).n_written == 0
        assert verify(store) == ()


def _run(number: int) -> RunRecord:
    return replace(flights.RUN, run_id=f"{number:08}-0b1e-4c62-9d2b-2f0f8f2d9a11")


def test_verify_compares_what_is_derived(store: Store) -> None:
    with duckdb.connect(store.index_path) as connection:
        connection.execute("UPDATE coverage SET covered = covered + 1")
    (problem,) = verify(store)
    assert "the rows of coverage are not those that were published" in problem
    index.rebuild(store)
    assert verify(store) == ()


def test_an_old_flight_without_tracks_is_not_taken_for_a_damaged_one(store: Store) -> None:
    """When another one is: the reason is looked for in the files that each flight has."""
    damaged, old = (store.flight_dir(flights.flight_id_of(name)) for name in "ab")
    (damaged / "segments.parquet").write_bytes(b"\xff" * (damaged / "segments.parquet").stat().st_size)
    (old / "tracks.parquet").unlink()
    result = json.loads((old / "result.json").read_text())
    del result["files"]["tracks.parquet"], result["sha256"]
    (old / "result.json").write_text(json.dumps(result))
    assert [one.folder for one in index.rebuild(store).damaged] == [damaged]


def test_names_that_are_no_text_are_published(store: Store) -> None:
    add_tag(store, flights.flight_id_of("a"), "pilot", os.fsdecode(b"J\xf6rg"))
    index.publish(store)
    assert ask(store, "SELECT value FROM flight_tags") == [("J?rg",)]


def test_readers_keep_what_they_opened(store: Store) -> None:
    with duckdb.connect(store.index_path, read_only=True) as reader:
        flights.write_flight(store, "c", 1)
        index.publish(store)
        assert reader.execute("SELECT count(*) FROM flights").fetchall() == [(2,)]
        assert reader.execute("SELECT count(*) FROM frames").fetchall() == [(7,)]
    assert ask(store, "SELECT count(*) FROM flights") == [(3,)]


def test_publishes_at_once_lose_nothing(store: Store) -> None:
    children = []
    for name in ("c", "d", "e"):
        child = os.fork()
        if child == 0:
            flights.write_flight(store, name, 2)
            index.publish(store)
            os._exit(0)
        children.append(child)
    assert [os.waitpid(child, 0)[1] for child in children] == [0, 0, 0]
    assert set(flights.versions_in_index(store)) == set("abcde")
    assert verify(store) == ()


def test_a_newer_index_is_refused_and_rebuilt_on_demand(store: Store) -> None:
    with duckdb.connect(store.index_path) as connection:
        connection.execute(
            "INSERT INTO schema_version VALUES (?, now()::TIMESTAMP, '9')", [len(MIGRATIONS) + 1]
        )
    flights.write_flight(store, "c", 1)
    for action in (index.publish, verify):
        with pytest.raises(StoreVersionError, match="upgrade lsnet-pipe") as caught:
            action(store)
        assert caught.value.exit_code == 12
    assert index.rebuild(store).n_flights == 3


def test_an_older_index_is_migrated(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the next version of the program would: one more migration, applied even when no flight is new."""
    number = len(MIGRATIONS) + 1
    later = {f"{number:04}_later.sql": "ALTER TABLE flights ADD COLUMN pilot VARCHAR DEFAULT 'unknown'"}
    for module in (index, schema):
        monkeypatch.setattr(module, "MIGRATIONS", (*MIGRATIONS, *later))
        monkeypatch.setattr(module, "read_schema", lambda name: later.get(name) or read_schema(name))
    assert index.publish(store).n_written == 0
    assert ask(store, "SELECT max(version) FROM schema_version") == [(number,)]
    assert ask(store, "SELECT DISTINCT pilot FROM flights") == [("unknown",)]
    inode = store.index_path.stat().st_ino
    index.publish(store)
    assert store.index_path.stat().st_ino == inode
    assert verify(store) == ()


def test_a_new_release_brings_its_views(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index, "app_version", lambda: "99.0")
    index.publish(store)
    assert ask(store, "SELECT DISTINCT app_version FROM schema_version") == [("99.0",)]


def test_a_full_disk_leaves_the_old_index(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    before = store.index_path.read_bytes()
    flights.write_flight(store, "c", 1)

    def fail(*_: object) -> None:
        raise duckdb.IOException("Could not write file: No space left on device")

    monkeypatch.setattr(index, "replace_rows", fail)
    with pytest.raises(StoreError, match="No space left"):
        index.publish(store)
    assert store.index_path.read_bytes() == before
    monkeypatch.undo()
    assert index.publish(store).n_flights == 3


def test_views_find_planted_faults(tmp_path: Path) -> None:
    """Frames 10 to 16 without segments around the bad frame 13; after frame 19, four frames are missing."""
    store = Store(tmp_path)
    flight_id = flights.flight_id_of("planted")
    with store.write_flight(flight_id) as staging, flights.FlightWriter(staging.path, flight_id) as writer:
        rows = flights.TrackedRows(writer)
        for i in range(30):
            step = i if i < 20 else i + 4
            if i == 13:
                rows.add_frame(flights.frame(i, "corrupt JPEG", step=step), None)
            else:
                rows.add_frame(flights.frame(i, step=step), flights.detections(0 if 10 <= i <= 16 else 2))
        staging.commit(flights.record("planted", rows.finish()))
    index.publish(store)
    start = flights.START_NS
    assert ask(store, "SELECT * EXCLUDE (flight_id, start_utc) FROM detection_gaps") == [
        (1, 10, 16, 6, start + 10 * flights.PERIOD_NS, 0.6, None)
    ]
    assert ask(store, "SELECT * EXCLUDE (flight_id, start_utc) FROM frame_dropouts") == [
        (1, 19, 20, start + 19 * flights.PERIOD_NS, 0.5, None, 4)
    ]
    assert ask(store, "SELECT topic, frame_idx, reason FROM bad_frames") == [
        (flights.TOPIC, 13, "corrupt JPEG")
    ]
    assert ask(
        store, "SELECT n_frames_with_segments, detection_share, duration_s, model_name FROM flight_summary"
    ) == [(23, 23 / 29, 3.3, "fast")]


def test_a_span_that_no_flight_has_seen(store: Store) -> None:
    """Flights without positions see no span; the question is answered over all flights."""
    ends = ("L12", "T1", "T2", 47.0, 8.0, None, 47.001, 8.0, None, 111.2, None)
    import_spans(store, [Span("S1", *ends), Span("S2", *ends)])
    index.publish(store)
    assert ask(store, "SELECT span_id, line_id, length_m FROM unseen_spans ORDER BY 1") == [
        ("S1", "L12", 111.2),
        ("S2", "L12", 111.2),
    ]
    assert find_query("unseen").parameters == ()


def test_files_are_of_the_storage_version_both_duckdbs_read(store: Store) -> None:
    tags = ask(store, "SELECT tags['storage_version'] FROM duckdb_databases() WHERE database_name = 'index'")
    assert tags[0][0].startswith("v1.5.0")


def test_odd_folders(tmp_path: Path) -> None:
    store = Store(tmp_path / "line=L12/flight_id=5/in[sp]ect/it's" / 'a "b" {c} #1=ü')
    flights.write_flight(store, "a", 3)
    index.publish(store)
    assert verify(store) == ()
    assert ask(store, "SELECT count(*) FROM frames") == [(3,)]


@pytest.mark.parametrize("name", ["wh?t", "st*r", "back\\slash", "a\nb"])
def test_impossible_folders(tmp_path: Path, name: str) -> None:
    with pytest.raises(StoreError, match="use another folder"):
        Store(tmp_path / name)


def test_hostile_names_stay_inert(tmp_path: Path) -> None:
    store = Store(tmp_path / "it's; DROP TABLE flights")
    name = "a'); DROP TABLE flights; --\n\x1b[31m\u202e\"\\"
    flights.write_flight(store, name, 3)
    index.publish(store)
    index.rebuild(store)
    assert ask(store, "SELECT source_uri FROM flights") == [(f"file:///inbox/{name}.mcap",)]
    assert json.loads((store.root / "manifest.jsonl").read_text().splitlines()[0])["source"].endswith(".mcap")
