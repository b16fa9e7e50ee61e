"""Batches with a stub detector: what is done, what is given up, what is left."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from dataclasses import asdict
from datetime import datetime, timedelta
from typing import TYPE_CHECKING
from urllib.parse import unquote_to_bytes, urlsplit

import duckdb
import pytest
from driver import fork_worker
from factories import Shot, make_recording, shots
from fakes import forbid
from stubs import HANG, LIGHT, RAISE, InlineExecutor, MakeStub

from inspect_pipeline.batch.options import BatchOptions
from inspect_pipeline.batch.quarantine import Quarantine
from inspect_pipeline.batch.run import plan_batch, run_batch
from inspect_pipeline.batch.stop_request import StopRequest
from inspect_pipeline.batch.worker import Job
from inspect_pipeline.config import ProcessOptions
from inspect_pipeline.errors import StoreBusyError
from inspect_pipeline.index import publish as index
from inspect_pipeline.index.verify import verify
from inspect_pipeline.store.runs import load_runs
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import Any

    from inspect_pipeline.store.runs import RunSummary


class Night:
    """An inbox, a store, and batches over them."""

    def __init__(self, folder: Path) -> None:
        self.inbox, self.store = folder / "inbox", Store(folder / "store")
        self.inbox.mkdir()
        self.stub = MakeStub(folder)
        self.events: list[tuple[str, dict[str, Any]]] = []

    def add(self, name: str, *numbers: int) -> Path:
        path = make_recording(self.inbox / f"{name}.mcap", [Shot(n, log_time_ns=10**18 + n) for n in numbers])
        os.utime(path, ns=(time.time_ns() - 100 * 10**9,) * 2)
        return path

    def run(self, *, stop: StopRequest | None = None, every: int = 1, **options: Any) -> RunSummary:
        job = Job(self.store.root, ProcessOptions(every=every), self.stub)
        self.events.clear()
        return run_batch(self.store, job, BatchOptions((str(self.inbox),), **options), self.report, stop)

    def report(self, event: str, **fields: object) -> None:
        self.events.append((event, fields))

    def counts(self, summary: RunSummary) -> dict[str, int]:
        """The counts of recordings that are not 0."""
        said = asdict(summary.counts)
        return {name[2:]: n for name, n in said.items() if n and name[2:] not in ("frames", "segments")}

    def indexed(self) -> dict[str, int]:
        with duckdb.connect(self.store.index_path, read_only=True) as connection:
            rows = connection.execute("SELECT source_uri, n_frames FROM flights").fetchall()
        return {uri.rsplit("/", 1)[1]: n_frames for uri, n_frames in rows}


@pytest.fixture
def real_night(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bare_flights: None) -> Iterator[Night]:
    """With worker processes, which take over sys.path, and whose interpreters need not start."""
    monkeypatch.syspath_prepend(LIGHT)
    monkeypatch.setattr("inspect_pipeline.batch.local.subprocess.Popen", fork_worker)
    night = Night(tmp_path)
    yield night
    staging = night.store.root / "staging"
    assert not staging.exists() or [p.name for p in staging.iterdir()] == ["mutex"]


@pytest.fixture
def night(real_night: Night, monkeypatch: pytest.MonkeyPatch) -> Night:
    """In this process."""
    monkeypatch.setattr("inspect_pipeline.batch.options.LocalExecutor", InlineExecutor)
    return real_night


def test_new_recordings_are_processed_once(night: Night) -> None:
    for i in range(3):
        night.add(f"r{i}", *range(i, i + 3))
    first = night.run(n_workers=2, tags={"line": "L12"})
    assert (first.exit_code, night.counts(first)) == (0, {"found": 3, "processed": 3})
    assert first.counts.n_frames == 9
    assert night.indexed() == {"r0.mcap": 3, "r1.mcap": 3, "r2.mcap": 3}
    night.stub = MakeStub(night.inbox.parent / "again")
    (night.inbox / "r0.mcap").rename(night.inbox / "renamed.mcap")
    (night.inbox / "r1.mcap").touch()
    second = night.run(settle_s=0)
    assert (second.exit_code, night.counts(second)) == (0, {"found": 3, "skipped": 3})
    assert night.stub.n_images() == 0
    assert [event for event, _ in night.events].count("recording done") == 2  # only these were read
    assert json.loads((night.store.root / "summary.json").read_text())["counts"]["n_skipped"] == 3
    assert load_runs(night.store) == [first, second]
    assert first.run.tags == {"line": "L12"}


def test_refused_recordings_go_to_quarantine_and_stay_in_place(night: Night) -> None:
    night.add("good", 1, 2)
    raising, unreadable = night.add("raise", 1, RAISE), night.add("none", 1)
    unreadable.write_bytes(b"no recording" * 9)
    os.utime(unreadable, (0, 0))
    before = {path: path.read_bytes() for path in night.inbox.iterdir()}
    summary = night.run()
    assert (summary.exit_code, night.counts(summary)) == (3, {"found": 3, "processed": 1, "quarantined": 2})
    notes = {note.path: note for note in Quarantine(night.store).notes()}
    for path, reason, words in (
        (raising, "error", "planted"),
        (unreadable, "unreadable", "not an MCAP file"),
    ):
        note = notes[str(path)]
        assert (note.reason, note.attempts, note.app_version) == (reason, 1, summary.run.app_version)
        assert words in note.detail
        assert (night.store.root / "quarantine" / f"{note.note_id}.json").exists()
    assert {path: path.read_bytes() for path in night.inbox.iterdir()} == before
    again = night.run()
    assert (again.exit_code, night.counts(again)) == (3, {"found": 3, "skipped": 1, "in_quarantine": 2})


def test_a_recording_of_telemetry_is_skipped(night: Night) -> None:
    night.add("telemetry")
    for _ in range(2):
        summary = night.run()
        assert (summary.exit_code, night.counts(summary)) == (0, {"found": 1, "skipped": 1})
        (fields,) = [fields for event, fields in night.events if event == "recording without images skipped"]
        assert fields == {"path": str(night.inbox / "telemetry.mcap"), "reason": "no camera topic"}


def test_a_split_recording_with_a_missing_part_goes_to_quarantine(night: Night) -> None:
    bag = night.inbox / "bag"
    bag.mkdir()
    night.add("bag/b_0", 1)
    (bag / "metadata.yaml").write_text("relative_file_paths:\n  - b_0.mcap\n  - b_1.mcap\n")
    summary = night.run(settle_s=0.05)  # the part may be on its way
    assert (summary.exit_code, night.counts(summary)) == (0, {"found": 1, "waiting": 1})
    os.utime(bag / "b_0.mcap", (0, 0))
    summary = night.run()
    assert (summary.exit_code, night.counts(summary)) == (3, {"found": 1, "quarantined": 1})
    (note,) = Quarantine(night.store).notes()
    assert "b_1.mcap: metadata.yaml lists it but it is absent" in note.detail


def test_a_camera_without_one_good_frame_fails_every_night(night: Night) -> None:
    """The flight is kept, with its bad frames; no night passes as a success until it is out of the inbox."""
    good, blind = night.add("good", 1, 2), night.inbox / "blind.mcap"
    make_recording(blind, [Shot(i, log_time_ns=10**18 + i, data=b"no image") for i in range(3)])
    os.utime(blind, ns=(time.time_ns() - 100 * 10**9,) * 2)
    for counts in ({"processed": 1}, {"skipped": 1}):
        summary = night.run()
        assert summary.exit_code == 3
        found = {name: n for name, n in night.counts(summary).items() if name not in ("bad_frames", "lines")}
        assert found == {"found": 2, "failed": 1, **counts}
    assert night.indexed() == {"good.mcap": 2, "blind.mcap": 3}
    blind.unlink()
    assert night.run().exit_code == 0
    assert good.exists()


def test_why_a_recording_failed_is_reported(night: Night) -> None:
    path = make_recording(night.inbox / "blind.mcap", [Shot(1, data=b"no image")])
    os.utime(path, ns=(time.time_ns() - 100 * 10**9,) * 2)
    summary = night.run()
    assert (summary.counts.n_frames, summary.counts.n_bad_frames) == (1, 1)
    (reason,) = [fields["reason"] for event, fields in night.events if event == "recording failed"]
    assert "/camera" in reason
    assert "\n" not in reason


def test_a_damaged_flight_is_processed_again(night: Night) -> None:
    """One byte of its rows has changed: a rebuild leaves it out with a line, the next night makes it anew."""
    night.add("a", 1, 2)
    night.add("b", 3)
    night.run()
    before = night.indexed()
    (folder,) = [f.folder for f in night.store.scan()[0] if f.record.source_uri.endswith("a.mcap")]
    path = folder / "frames.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    assert night.run().counts.n_skipped == 2  # rows that are in the index are not read again
    assert [damage.folder for damage in index.rebuild(night.store).damaged] == [folder]
    summary = night.run()
    assert (summary.counts.n_processed, summary.counts.n_skipped) == (1, 1)
    assert night.indexed() == before
    assert verify(night.store) == ()


def test_a_late_recording_is_given_up(real_night: Night) -> None:
    real_night.add("late", HANG)
    summary = real_night.run(timeout_s=1.0, max_attempts=1)
    assert (summary.exit_code, real_night.counts(summary)) == (3, {"found": 1, "quarantined": 1})
    (note,) = Quarantine(real_night.store).notes()
    assert (note.reason, note.detail, note.attempts) == ("timeout", "not done after 1 s", 1)


def test_a_mended_recording_leaves_quarantine(night: Night) -> None:
    night.add("a", RAISE)
    assert night.run(max_attempts=1).exit_code == 3
    night.add("a", 1, 2)
    assert night.run().exit_code == 0
    assert Quarantine(night.store).notes() == []


def test_another_config_or_model_is_processed_again(night: Night) -> None:
    night.add("a", 1, 2, 3, 4)
    night.add("bad", RAISE)
    night.run(max_attempts=1)
    assert night.counts(night.run(every=2, max_attempts=1)) == {"found": 2, "processed": 1, "quarantined": 1}
    assert night.indexed() == {"a.mcap": 2}


def test_limit_plan_and_files_still_being_written(night: Night) -> None:
    paths = [night.add(f"r{i}", i) for i in range(4)]
    with paths[3].open("ab") as file:  # a recorder at work
        file.write(b"more")
    job = Job(night.store.root, ProcessOptions(), night.stub)
    options = BatchOptions((str(night.inbox),), limit=2)
    assert [c.path for c in plan_batch(night.store, job, options, night.report)] == paths[:2]
    assert not night.store.root.exists()
    assert night.counts(night.run(limit=2)) == {"found": 4, "processed": 2, "left": 2}
    paths[2].touch()
    summary = night.run(settle_s=0.3)
    assert night.counts(summary) == {"found": 4, "processed": 1, "skipped": 2, "waiting": 1}
    assert summary.exit_code == 0


def test_an_annotated_copy_is_skipped_without_being_read_again(night: Night) -> None:
    night.add("a", 1)
    night.run()
    (copy,) = night.store.root.glob("flights/*/annotated.mcap")
    copy.rename(night.inbox / "copy.mcap")
    (night.inbox / "a.mcap").unlink()
    assert night.counts(night.run(settle_s=0)) == {"found": 1, "skipped": 1}
    assert night.counts(night.run(settle_s=0)) == {"found": 1, "skipped": 1}
    assert "recording done" not in [event for event, _ in night.events]


def test_odd_names_are_only_names_and_links_out_stay_unread(night: Night) -> None:
    names = [
        b"\xff\xfe",
        b"-rf",
        b"a\nb'; DROP TABLE flights; --",
        b"$(touch owned) `x` %s {0} 50%",
        b"x" * 250,
    ]
    for i, name in enumerate(names):
        night.add("new", i).rename(night.inbox / f"{os.fsdecode(name)}.MCAP")
    (night.inbox / "sub\u202efolder").mkdir()
    night.add("new", 9).rename(night.inbox / "sub\u202efolder" / ".mcap.mcap")
    bad = night.inbox / os.fsdecode(b"bad\xff\x1b[2J.mcap")
    night.add("new", RAISE).rename(bad)
    outside = make_recording(night.inbox.parent / "secret.mcap", shots(1))
    (night.inbox / "link.mcap").symlink_to(outside)
    (night.inbox / "dangling.mcap").symlink_to("/nowhere")
    summary = night.run()
    assert night.counts(summary) == {"found": 7, "processed": 6, "quarantined": 1}
    assert ("link out of the inbox left alone", {"path": str(night.inbox / "link.mcap")}) in night.events
    assert [note.path for note in Quarantine(night.store).notes()] == [str(bad)]
    assert night.counts(night.run()) == {"found": 7, "skipped": 6, "in_quarantine": 1}
    with duckdb.connect(night.store.index_path, read_only=True) as connection:
        uris = [uri for (uri,) in connection.execute("SELECT source_uri FROM flights").fetchall()]
    stored = {unquote_to_bytes(urlsplit(uri).path) for uri in uris}
    assert stored == {os.fsencode(p) for p in night.inbox.rglob("*") if p.is_file()} - {
        os.fsencode(bad),
        os.fsencode(night.inbox / "link.mcap"),
    }


def test_hostile_topic_names_are_only_names(night: Night) -> None:
    topic = "/a\n'; DROP TABLE flights; --/../../\x1b[31m"
    path = make_recording(night.inbox / "a.mcap", shots(2, topic))
    assert night.run(settle_s=0).counts.n_processed == 1
    with duckdb.connect(night.store.index_path, read_only=True) as connection:
        assert connection.execute("SELECT topic FROM channels").fetchall() == [(topic,)]
    assert path.exists()


def test_old_annotated_copies_are_removed_and_their_rows_stay(night: Night) -> None:
    night.add("old", 1, 2)
    night.run()
    (old,) = night.store.root.glob("flights/*/annotated.mcap")
    _ingest_earlier(old.with_name("result.json"), timedelta(days=31))
    night.add("new", 1)
    assert night.run(keep_annotated_days=30).exit_code == 0
    assert [path.exists() for path in (old, old.with_name("frames.parquet"))] == [False, True]
    assert len(list(night.store.root.glob("flights/*/annotated.mcap"))) == 1
    assert night.indexed() == {"old.mcap": 2, "new.mcap": 1}
    assert verify(night.store) == ()
    flight_id = json.loads(old.with_name("result.json").read_text())["flight_id"]
    assert ("annotated copy removed", {"flight_id": flight_id}) in night.events
    assert night.counts(night.run(keep_annotated_days=30)) == {"found": 2, "skipped": 2}
    assert "annotated copy removed" not in [event for event, _ in night.events]
    old.write_bytes(b"left by a kill between the record and the file")
    night.run(keep_annotated_days=30)
    assert not old.exists()


def _ingest_earlier(result: Path, age: timedelta) -> None:
    """Date the record of a flight back."""
    value = json.loads(result.read_text())
    then = datetime.fromisoformat(value["ingested_at"]) - age
    result.write_text(json.dumps(value | {"ingested_at": then.isoformat()}))


def test_a_detector_that_cannot_be_loaded_ends_the_run(night: Night) -> None:
    night.add("a", 1)
    night.stub = MakeStub(night.inbox.parent, "none")
    summary = night.run()
    assert (summary.exit_code, night.counts(summary)) == (1, {"found": 1, "left": 1})
    assert summary.error == "no weights named 'none'"
    assert load_runs(night.store) == [summary]


def test_a_store_that_fails_ends_the_run_and_blames_no_recording(night: Night) -> None:
    night.add("a", 1)
    night.store.root.mkdir()
    (night.store.root / "flights").touch()
    summary = night.run()
    assert (summary.exit_code, night.counts(summary)) == (1, {"found": 1, "left": 1})
    assert "a file is where a folder should be" in (summary.error or "")
    assert Quarantine(night.store).notes() == []
    (night.store.root / "flights").unlink()


@pytest.mark.parametrize("name", ["spans.geojson", "rules.toml"])
def test_spans_and_rules_that_are_damaged_end_the_run_with_an_error(night: Night, name: str) -> None:
    night.add("a", 1)
    night.store.root.mkdir()
    (night.store.root / name).write_text("{")
    summary = night.run()
    assert (summary.exit_code, night.counts(summary)) == (1, {"found": 1, "processed": 1})
    assert name in (summary.error or "")
    assert load_runs(night.store) == [summary]
    assert json.loads((night.store.root / "summary.json").read_text())["exit_code"] == 1
    assert night.events[-1] == ("batch finished", {"exit_code": 1, "error": summary.error})


def test_folders_that_may_not_be_read_are_reported(night: Night, monkeypatch: pytest.MonkeyPatch) -> None:
    night.add("a", 1)
    closed = night.inbox / "closed"
    closed.mkdir()
    forbid(monkeypatch, closed)
    assert night.counts(night.run()) == {"found": 1, "processed": 1}
    assert ("folder of the inbox cannot be read", {"path": str(closed)}) in night.events


def test_a_stop_leaves_the_rest_untouched(night: Night) -> None:
    night.add("a", HANG)
    stop = StopRequest()
    stop.exit_code = 143
    summary = night.run(stop=stop)
    assert (summary.exit_code, night.counts(summary)) == (143, {"found": 1, "left": 1})


def test_one_batch_per_store(night: Night) -> None:
    with night.store.batch_lock(), pytest.raises(StoreBusyError, match=f"pid {os.getpid()} since"):
        night.run()


def test_two_recordings_of_the_same_content_are_one_flight(night: Night) -> None:
    night.add("a", 1, 2)
    night.add("b", 1, 2)
    night.run(n_workers=2)
    with duckdb.connect(night.store.index_path, read_only=True) as connection:
        rows = connection.execute("SELECT flight_id, frame_idx FROM frames").fetchall()
    assert set(Counter(rows).values()) == {1}
    assert len(rows) == 2
