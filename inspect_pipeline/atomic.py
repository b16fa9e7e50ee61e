"""File system steps that a crash cannot tear: fsync, swap of folders, locks that end with their process."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TextIO

from inspect_pipeline.errors import StoreWriteError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
_NO_EXCHANGE = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP)

_EXPLANATIONS = {
    errno.ENOSPC: ("there is no space left on the device", "free some and run again"),
    errno.EDQUOT: ("the disk quota is used up", "free some space and run again"),
    errno.EROFS: ("the file system is read-only", "use another folder"),
    errno.EACCES: ("permission denied", "check its owner and mode, or use another folder"),
    errno.EPERM: ("permission denied", "check its owner and mode, or use another folder"),
    errno.ENOTDIR: ("a file is where a folder should be", "move it away or use another folder"),
    errno.EEXIST: ("a file is where a folder should be", "move it away or use another folder"),
}
OUT_OF_SPACE = (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def store_errors(path: Path) -> Iterator[None]:
    """Raise the OSErrors of a block as StoreWriteErrors about `path`."""
    try:
        yield
    except OSError as error:
        raise explain_os_error(path, error) from error


def explain_os_error(path: Path, error: OSError) -> StoreWriteError:
    """The StoreWriteError about `path` that says what an OSError means and what to do."""
    other = (error.strerror or str(error), "check the disk, then run again")
    problem, remedy = _EXPLANATIONS.get(error.errno or 0, other)
    return StoreWriteError(path, problem, remedy)


def fsync_path(path: Path) -> None:
    """Make a file, or the names in a folder, survive a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fsync_tree(folder: Path) -> None:
    """Make a folder and everything below it survive a power cut."""
    for path in folder.rglob("*"):
        fsync_path(path)
    fsync_path(folder)


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """A name to write to, which becomes `target` at the end of the block, and is gone after an exception.

    Raises OSError.
    """
    part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(target)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Make a text file appear in place of an older one, whole or not at all; raises OSError."""
    following = path.with_name(f".{path.name}.next")
    following.write_text(text, encoding="utf-8")
    fsync_path(following)
    following.replace(path)
    fsync_path(path.parent)


def move_folder_into_place(new: Path, final: Path, aside: Path) -> None:
    """Make `new` appear as `final`, in one step, whether `final` exists or not.

    An old `final` is left at `new`, or at `aside` where the file system cannot exchange two names. There,
    a crash between the two renames leaves `final` missing and `aside` whole: see `undo_move_aside`.
    """
    try:
        new.rename(final)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        _replace_folder(new, final, aside)


def _replace_folder(new: Path, final: Path, aside: Path) -> None:
    try:
        _exchange(new, final)
    except OSError as error:
        if error.errno not in _NO_EXCHANGE:
            raise
        final.rename(aside)
        new.rename(final)


def undo_move_aside(final: Path, aside: Path) -> None:
    """Bring back a `final` that a killed `move_folder_into_place` had moved to `aside`."""
    if aside.exists() and not final.exists():
        aside.rename(final)


def _exchange(first: Path, second: Path) -> None:
    """Swap two names atomically (renameat2 of Linux 3.15); raises OSError."""
    libc = ctypes.CDLL(None, use_errno=True)
    try:
        renameat2 = libc.renameat2
    except AttributeError as error:  # a C library without it
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS)) from error
    if renameat2(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code), str(first))


def acquire_lock(path: Path, *, wait: bool) -> TextIO:
    """The file `path`, made if missing and locked until it is closed or its process ends.

    Raises BlockingIOError when another process holds it and `wait` is false.
    """
    file = path.open("a+", encoding="utf-8")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BaseException:
        file.close()
        raise
    return file
