"""Publishing: the index says what the flights say, and is always whole for its readers."""

from __future__ import annotations

import json
import os
import shutil
from typing import TYPE_CHECKING

import duckdb
import flights
import pytest
from stores import TABLES, answers, ask

from inspect_pipeline.errors import StoreError, StoreVersionError
from inspect_pipeline.index import publish as index
from inspect_pipeline.index import schema
from inspect_pipeline.index.reading import select
from inspect_pipeline.index.verify import verify
from inspect_pipeline.resources import MIGRATIONS, read_schema
from inspect_pipeline.store.feedback import add_tag
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path


def test_published_rows(published: Store) -> None:
    a, b = flights.flight_id_of("a"), flights.flight_id_of("b")
    assert ask(
        published, "SELECT flight_id, n_frames, n_bad_frames, n_segments, n_lines FROM flights ORDER BY ALL"
    ) == [*sorted([(a, 3, 1, 2, 1), (b, 4, 1, 5, 2)])]
    assert ask(published, f"SELECT frame_idx, status, n_segments FROM frames WHERE flight_id = '{b}'") == [
        (0, "ok", 0),
        (1, "bad", 0),
        (2, "ok", 2),
        (3, "ok", 3),
    ]
    assert ask(published, "SELECT count(*), sum(x2 - x1), max(angle_deg) < 180 FROM segments") == [
        (7, 21.0, True)
    ]
    assert ask(published, "SELECT model_id, score_threshold FROM models") == [("fast-1", 0.5)]
    assert ask(published, "SELECT run_id::VARCHAR, started_at::VARCHAR, config->>'every' FROM runs") == [
        (flights.RUN.run_id, "2026-01-02 03:04:05", "1")
    ]


def test_times_stand_beside_their_nanoseconds(published: Store) -> None:
    columns = "log_time_ns, log_time_utc::VARCHAR, stamp_utc::VARCHAR"
    assert ask(published, f"SELECT DISTINCT {columns} FROM frames WHERE frame_idx = 2") == [
        (flights.START_NS + 200_000_000, "2023-11-14 22:13:20.323456", "2023-11-14 22:13:20.323456")
    ]
    assert ask(published, "SELECT DISTINCT first_ns, last_utc::VARCHAR FROM channels ORDER BY ALL") == [
        (flights.START_NS, "2023-11-14 22:13:20.323456"),
        (flights.START_NS, "2023-11-14 22:13:20.423456"),
    ]
    assert ask(published, "SELECT count(*) FROM flights WHERE ingested_at = '2026-01-02 03:04:06.5'") == [
        (2,)
    ]


def test_files_are_of_the_storage_version_both_duckdbs_read(published: Store) -> None:
    tags = ask(
        published, "SELECT tags['storage_version'] FROM duckdb_databases() WHERE database_name = 'index'"
    )
    assert tags[0][0].startswith("v1.5.0")


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
    before = answers(store)
    assert all(before[name] for name in TABLES)
    store.index_path.unlink()
    index.rebuild(store)
    assert answers(store) == before


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


def test_other_views_are_refused_and_replaced_by_the_next_publish(store: Store) -> None:
    with duckdb.connect(store.index_path) as connection:
        connection.execute("CREATE OR REPLACE VIEW flight_summary AS SELECT 1 AS old")
        connection.execute("UPDATE inputs SET sha256 = 'older' WHERE name = 'views.sql'")
    with pytest.raises(StoreVersionError, match="of another version; run lsnet-pipe index rebuild"):
        select(store, "SELECT n_frames FROM flight_summary")
    assert index.publish(store).n_written == 0
    assert len(select(store, "SELECT n_frames FROM flight_summary")) == 2


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
