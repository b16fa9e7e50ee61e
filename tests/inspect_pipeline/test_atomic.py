"""Output files appear whole; devices and FIFOs are written to, never replaced; locks outlive removal."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest

from inspect_pipeline import atomic
from inspect_pipeline.atomic import acquire_lock, appearing, write_whole

if TYPE_CHECKING:
    from pathlib import Path


def write(target: Path, text: str = "new") -> None:
    with appearing(target) as part:
        part.write_text(text)


def test_a_file_is_replaced_whole_and_keeps_its_mode(tmp_path: Path) -> None:
    target = tmp_path / "rows.csv"
    target.write_text("old")
    target.chmod(0o600)
    with target.open() as reader:
        write(target)
        assert target.read_text() == "new"
        assert reader.read() == "old"
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert list(tmp_path.iterdir()) == [target]


def test_an_exception_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "rows.csv"
    target.write_text("old")
    with suppress(KeyboardInterrupt), appearing(target) as part:
        part.write_text("half")
        raise KeyboardInterrupt
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("exists", [True, False])
@pytest.mark.parametrize("writer", [write, lambda path: write_whole(path, "new")])
def test_links_are_followed(tmp_path: Path, exists: bool, writer: object) -> None:
    (tmp_path / "folder").mkdir()
    target, link = tmp_path / "folder" / "rows.csv", tmp_path / "link"
    link.symlink_to("folder/rows.csv")
    if exists:
        target.write_text("old")
    writer(link)  # type: ignore[operator]
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert [path.name for path in target.parent.iterdir()] == ["rows.csv"]


@pytest.mark.skipif(os.geteuid() != 0, reason="makes a device node")
def test_a_device_is_written_to(tmp_path: Path) -> None:
    null = tmp_path / "null"
    try:
        os.mknod(null, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
        null.open("w").close()
    except PermissionError:
        pytest.skip("this container allows no device nodes")
    write(null)
    (tmp_path / "link").symlink_to(null)
    write(tmp_path / "link")
    assert stat.S_ISCHR(null.lstat().st_mode)
    assert (tmp_path / "link").is_symlink()


def test_a_fifo_is_written_to(tmp_path: Path) -> None:
    fifo, read = tmp_path / "fifo", []
    os.mkfifo(fifo)
    reader = threading.Thread(target=lambda: read.append(fifo.read_text()))
    reader.start()
    write(fifo)
    reader.join()
    assert read == ["new"]
    assert stat.S_ISFIFO(fifo.lstat().st_mode)


def test_a_fifo_that_nobody_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "_READER_WAIT_S", 0.1)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(OSError, match="nobody reads from it"):
        write(tmp_path / "fifo")


@pytest.mark.parametrize("target", [".", "..", "/", ""])
def test_a_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(IsADirectoryError, match="it is a folder"):
        write(type(tmp_path)(target))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("mode", ["a", "r+"])  # as by >> and by > of a shell
@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "mine"])
def test_stdout_by_name_is_written_on(tmp_path: Path, name: str, mode: str) -> None:
    """The lines in front stay, what comes after is behind, and the file is not replaced."""
    log = tmp_path / "log"
    log.write_text("before\n")
    (tmp_path / "mine").symlink_to("/dev/stdout")
    code = (
        "import sys, pathlib; from inspect_pipeline.atomic import appearing\n"
        "with appearing(pathlib.Path(sys.argv[1])) as part: part.write_text('new\\n')"
    )
    with log.open(mode) as stdout:
        stdout.seek(0, os.SEEK_END)
        subprocess.run([sys.executable, "-c", code, name], cwd=tmp_path, stdout=stdout, check=True)
        assert os.path.samestat(os.fstat(stdout.fileno()), log.stat())
        os.write(stdout.fileno(), b"after\n")
    assert log.read_text() == "before\nnew\nafter\n"


def test_a_lock_that_its_holder_removes_is_taken_anew(tmp_path: Path) -> None:
    """Else two processes would hold the lock, one by a file that has no name any more."""
    path, taken = tmp_path / "lock", []
    first = acquire_lock(path, wait=True)
    thread = threading.Thread(target=lambda: taken.append(acquire_lock(path, wait=True)))
    thread.start()
    path.unlink()
    first.close()
    thread.join()
    assert os.path.samestat(os.fstat(taken[0].fileno()), path.stat())
    with pytest.raises(BlockingIOError):
        acquire_lock(path, wait=False)
    taken[0].close()
