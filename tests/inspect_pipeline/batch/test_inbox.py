"""What is found in an inbox, and when a file counts as written."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from fakes import forbid

from inspect_pipeline.batch.inbox import Candidate, discover
from inspect_pipeline.errors import InboxError

WHOLE = b"\x89MCAP0\r\n" * 2


@pytest.fixture
def inbox(tmp_path: Path) -> Path:
    folder = tmp_path / "inbox"
    (folder / "day 1").mkdir(parents=True)
    return folder


def add(path: Path, content: bytes = WHOLE, age_s: float = 100.0) -> Path:
    path.write_bytes(content)
    os.utime(path, ns=(time.time_ns() - int(age_s * 1e9),) * 2)
    return path


def found(*inboxes: object, **options: object) -> list[Path]:
    return [candidate.path for candidate in discover(map(str, inboxes), **options).candidates]


def test_folders_files_and_globs_each_recording_once_oldest_first(inbox: Path) -> None:
    old, new = add(inbox / "day 1" / "z.mcap", age_s=200), add(inbox / "a.MCAP")
    add(inbox / "notes.txt")
    add(inbox / ".b.mcap.part")
    expected = [old, new]
    assert found(inbox) == found(inbox, inbox / "a.MCAP", f"{inbox}/**/*") == expected
    assert found(f"{inbox}/*") == found(f"{inbox.parent}/inb*") == expected
    assert found(f"{inbox}/day*/*.mcap") == [old]
    assert found(f"{inbox}/none*") == []


def test_since(inbox: Path) -> None:
    add(inbox / "old.mcap", age_s=3600)
    new = add(inbox / "new.mcap")
    assert found(inbox, since_ns=time.time_ns() - 1000 * 10**9) == [new]


def test_the_store_is_no_inbox(inbox: Path) -> None:
    add(inbox / "day 1" / "annotated.mcap")
    assert found(inbox, without=inbox / "day 1") == []


@pytest.mark.parametrize(
    "name", ["new\nline", "quo\"te's", "żółć", b"\xff\xfe", "$(id)", "[a]", "--help", "%s{0}"]
)
def test_odd_names(inbox: Path, name: str | bytes) -> None:
    path = add(inbox / (os.fsdecode(name) + ".mcap"))
    assert found(inbox) == found(path) == [path]


def test_what_is_not_there(inbox: Path) -> None:
    with pytest.raises(InboxError, match="mounted"):
        discover([str(inbox / "none")])


def test_an_inbox_that_may_not_be_read_is_no_empty_one(inbox: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(InboxError, match=f"{inbox}: it cannot be read .Permission denied.; check its rights"):
        found(inbox)


def test_folders_within_that_may_not_be_read_are_named(inbox: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, closed = add(inbox / "day 1" / "b.mcap"), inbox / "closed"
    closed.mkdir()
    forbid(monkeypatch, closed)
    for named in (inbox, f"{inbox}/*"):
        discovery = discover([str(named), str(named)])
        assert [candidate.path for candidate in discovery.candidates] == [path]
        assert discovery.unreadable == (closed,)


def bag(folder: Path, *parts: str) -> Path:
    folder.mkdir()
    listed = "".join(f"  - {name}\n" for name in parts)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}")
    return folder


def test_a_split_rosbag2_is_one_recording(inbox: Path, tmp_path: Path) -> None:
    folder = bag(inbox / "bag", "b_0.mcap", "bag/b_1.mcap")
    add(folder / "b_0.mcap", age_s=900)
    assert found(inbox) == [folder]
    assert not Candidate.at(folder).is_written(10)  # a part of it is still to come
    os.utime(folder / "b_0.mcap", (0, 0))
    assert Candidate.at(folder).is_written(10)  # or is lost, which the reader reports
    add(folder / "b_1.mcap", WHOLE * 3)
    expected = [folder]
    assert found(inbox) == found(folder) == found(f"{inbox}/*") == found(f"{inbox}/*/*.mcap") == expected
    stray = add(folder / "stray.mcap", age_s=50)
    assert found(inbox) == [folder, stray]
    candidate = Candidate.at(folder)
    assert candidate is not None
    assert candidate.size_bytes == len(WHOLE) * 4
    assert candidate.is_written(10)
    add(folder / "b_1.mcap", WHOLE[:-1])
    assert not candidate.is_written(10)
    assert not Candidate.at(folder).is_written(10)
    (folder / "b_0.mcap").unlink()
    (folder / "b_0.mcap").symlink_to(add(tmp_path / "secret.mcap"))
    assert discover([str(inbox)]).links_out == (folder,)
    one = bag(inbox / "one", "o_0.mcap")
    whole = add(one / "o_0.mcap")
    assert found(one) == [whole]


def test_what_systems_leave_beside_recordings_is_none(inbox: Path) -> None:
    whole = add(inbox / "a.mcap")
    add(inbox / "._a.mcap", b"\0\5\26\7")  # macOS
    for name in (".Trash-1000", ".Trashes", "$RECYCLE.BIN"):
        (inbox / name).mkdir()
        add(inbox / name / "old.mcap")
    assert found(inbox) == found(f"{inbox}/*.mcap") == [whole]


def test_links_out_of_the_inbox_are_left_alone(inbox: Path, tmp_path: Path) -> None:
    secret = add(tmp_path / "secret.mcap")
    (tmp_path / "elsewhere").mkdir()
    add(tmp_path / "elsewhere" / "b.mcap")
    (inbox / "link.mcap").symlink_to(secret)
    (inbox / "folder").symlink_to(tmp_path / "elsewhere")
    (inbox / "loop.mcap").symlink_to("loop.mcap")
    for named in (inbox, f"{inbox}/*.mcap"):
        discovery = discover([str(named)])
        assert discovery.candidates == ()
        assert discovery.links_out == (inbox / "link.mcap",)
    assert found(f"{inbox}/*/*.mcap") == []
    assert found(inbox / "link.mcap") == [inbox / "link.mcap"]  # named by hand


def test_no_files(inbox: Path) -> None:
    (inbox / "folder.mcap").mkdir()
    os.mkfifo(inbox / "pipe.mcap")
    assert found(inbox) == []


@pytest.mark.parametrize(
    ("content", "age_s", "is_written"),
    [
        (WHOLE, 100, True),
        (WHOLE, 1, False),
        (WHOLE, -5000, False),  # another clock
        (WHOLE[:-1], 100, False),
        (WHOLE[:-1], 4000, True),
        (b"", 100, False),
    ],
)
def test_written(inbox: Path, content: bytes, age_s: float, is_written: bool) -> None:
    candidate = Candidate.at(add(inbox / "a.mcap", content, age_s))
    assert candidate is not None
    assert candidate.is_written(10) == is_written


def test_a_file_that_grows_is_not_written(inbox: Path) -> None:
    path = add(inbox / "a.mcap", age_s=9.99)
    candidate = Candidate.at(path)
    assert candidate is not None
    add(path, WHOLE * 2, age_s=9.99)
    time.sleep(0.02)
    assert not candidate.is_written(10)
    path.unlink()
    assert not candidate.is_written(0)


def test_rest_is_measured_by_our_own_clock_too(inbox: Path) -> None:
    candidate = Candidate.at(add(inbox / "a.mcap", age_s=-5000))
    assert candidate is not None
    time.sleep(0.05)
    assert candidate.is_written(0.05)
