"""Damaged flights and indexes: found, reported, and of no consequence for others."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import duckdb
import flights
import pytest
from stores import answers, ask

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.verify import verify
from inspect_pipeline.store.runs import save_run, summarize_process
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.records import RunRecord


@pytest.fixture(scope="module")
def content_with_c(
    template: Store, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, list[tuple[Any, ...]]]:
    """What an index says that nobody damaged, after another flight."""
    store = Store(shutil.copytree(template.root, tmp_path_factory.mktemp("whole") / "inspections"))
    flights.write_flight(store, "c", 1)
    index.publish(store)
    return answers(store)


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
        damaged = bytearray(whole)
        damaged[13000::1000] = bytes(byte ^ 0xFF for byte in damaged[13000::1000])  # behind its headers
        path.write_bytes(damaged)
    elif damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    assert damage == "flipped" or verify(store)
    flights.write_flight(store, "c", 1)
    index.publish(store)
    assert answers(store) == content_with_c


def test_a_log_that_someone_left_is_not_replayed(store: Store) -> None:
    before = answers(store)
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
    assert answers(store) == before


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


class Flipped(NamedTuple):
    """A store with a changed byte in each flight but b, what `verify` found, and what a rebuild left."""

    store: Store
    has_checksums: bool
    problems: tuple[str, ...]
    left_out: set[Path]
    n_frames: dict[str, int]

    def folder(self, table: str) -> Path:
        return self.store.flight_dir(flights.flight_id_of(FLIPPED[table]))


FLIPPED = {"frames": "a", "segments": "c", "lines": "d", "tracks": "e"}  # the flight with a damaged table


@pytest.fixture(scope="module", params=[True, False], ids=["checksums", "no checksums"])
def flipped(
    request: pytest.FixtureRequest, template: Store, tmp_path_factory: pytest.TempPathFactory
) -> Flipped:
    """Flights of before checksums were kept are left out where DuckDB notices."""
    store = Store(shutil.copytree(template.root, tmp_path_factory.mktemp("flipped") / "inspections"))
    for table, name in FLIPPED.items():
        path = store.flight_dir(flights.write_flight(store, name, 3)) / f"{table}.parquet"
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 0xFF
        path.write_bytes(content)
        if not request.param:
            result = json.loads(path.with_name("result.json").read_text())
            del result["sha256"]
            path.with_name("result.json").write_text(json.dumps(result))
    problems = verify(store) if request.param else ()
    left_out = {one.folder for one in index.rebuild(store).damaged}
    return Flipped(store, request.param, problems, left_out, flights.versions_in_index(store))


@pytest.mark.parametrize("table", FLIPPED)
def test_one_flipped_byte_costs_one_flight(flipped: Flipped, table: str) -> None:
    folder = flipped.folder(table)
    assert flipped.n_frames["b"] == 4
    assert (folder in flipped.left_out) != (FLIPPED[table] in flipped.n_frames)
    if flipped.has_checksums:
        changed = f"{folder}: the checksum of {table}.parquet differs; process its recording again"
        assert changed in flipped.problems
        assert len(flipped.problems) == len(FLIPPED)
        assert flipped.store.load_flight(flights.flight_id_of(FLIPPED[table])) is None
        assert folder in flipped.left_out


def test_a_result_of_wrong_types_costs_one_flight(store: Store) -> None:
    folders = set()
    for name, field in (("a", "totals"), ("c", "channels"), ("d", "model")):
        result = store.flight_dir(flights.write_flight(store, name, 3)) / "result.json"
        whole = json.loads(result.read_text())
        changed = {
            "totals": whole["totals"] | {"n_frames": "many"},
            "channels": [whole["channels"][0] | {"channel_id": "x"}],
            "model": 5,
        }
        result.write_text(json.dumps(whole | {field: changed[field]}))
        folders.add(result.parent)
    assert {one.folder for one in index.rebuild(store).damaged} == folders
    assert set(flights.versions_in_index(store)) == {"b"}


def test_a_damaged_annotated_copy_is_found(store: Store) -> None:
    path = store.flight_dir(flights.flight_id_of("a")) / "annotated.mcap"
    path.write_bytes(b"x" + path.read_bytes()[1:])
    assert verify(store) == (
        f"{path.parent}: the checksum of annotated.mcap differs; process its recording again with --force",
    )
    assert index.rebuild(store).damaged == ()  # its rows are whole


def test_a_copied_folder_counts_once(store: Store) -> None:
    folder = store.flight_dir(flights.flight_id_of("a"))
    before = answers(store)
    shutil.copytree(folder, folder.with_name("backup"))
    (folder.parent / ".DS_Store").touch()
    (damage,) = index.rebuild(store).damaged
    assert damage.folder == folder.with_name("backup")
    assert damage.problem.startswith(f"a copy of flight {folder.name} under another name; remove it")
    assert answers(store) == before
    assert len(verify(store)) == 1


def test_a_rebuild_after_idle_nights_is_not_needed(store: Store) -> None:
    """DuckDB 2 trims free blocks at the end of the file: its size says nothing about its content."""
    for night in range(3):
        save_run(store, summarize_process(_run(night), [], n_found=0, n_failed=0, exit_code=0))
        assert index.publish(store).n_written == 0
        assert verify(store) == ()


def _run(number: int) -> RunRecord:
    return replace(flights.RUN, run_id=f"{number:08}-0b1e-4c62-9d2b-2f0f8f2d9a11")


def test_an_old_flight_without_tracks_is_not_taken_for_a_damaged_one(store: Store) -> None:
    """When another one is: the reason is looked for in the files that each flight has."""
    damaged, old = (store.flight_dir(flights.flight_id_of(name)) for name in "ab")
    (damaged / "segments.parquet").write_bytes(b"\xff" * (damaged / "segments.parquet").stat().st_size)
    (old / "tracks.parquet").unlink()
    result = json.loads((old / "result.json").read_text())
    del result["files"]["tracks.parquet"], result["sha256"]
    (old / "result.json").write_text(json.dumps(result))
    assert [one.folder for one in index.rebuild(store).damaged] == [damaged]
