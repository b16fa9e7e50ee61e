"""File system operations that are safe against crashes: whole files, swapped folders, locks."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import shutil
import stat
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from inspect_pipeline.errors import StoreWriteError

if TYPE_CHECKING:
    from collections.abc import Iterator

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
_NO_EXCHANGE = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP)
_READER_WAIT_S = 5.0  # for the other end of a FIFO

_NOT_A_FOLDER = ("a file is where a folder should be", "move it away or use another folder")
_DENIED = ("permission denied", "check its owner and mode, or use another folder")
_EXPLANATIONS = {
    errno.ENOSPC: ("there is no space left on the device", "free some and run again"),
    errno.EDQUOT: ("the disk quota is exceeded", "free some space and run again"),
    errno.EROFS: ("the file system is read-only", "use another folder"),
    errno.EACCES: _DENIED,
    errno.EPERM: _DENIED,
    errno.ENOTDIR: _NOT_A_FOLDER,
    errno.EEXIST: _NOT_A_FOLDER,
}


@contextmanager
def store_errors(path: Path) -> Iterator[None]:
    """Turn an OSError raised in the block into a StoreWriteError about `path`."""
    try:
        yield
    except OSError as error:
        raise explain_os_error(path, error) from error


def explain_os_error(path: Path, error: OSError) -> StoreWriteError:
    """Return the StoreWriteError about `path` that explains an OSError and what to do."""
    other = (error.strerror or str(error), "check the disk, then run again")
    problem, remedy = _EXPLANATIONS.get(error.errno or 0, other)
    return StoreWriteError(path, problem, remedy)


def fsync_path(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def fsync_tree(folder: Path) -> None:
    """Flush a folder and everything below it to the disk."""
    for path in folder.rglob("*"):
        fsync_path(path)
    fsync_path(folder)


@contextmanager
def appearing(target: Path) -> Iterator[Path]:
    """Yield a path to write to; it becomes `target` at the end of the block, or is removed on an exception.

    Symbolic links are followed, and an existing file keeps its mode. A target that is no regular file (a
    FIFO, a character device, /dev/stdout) is never replaced: the content is written to it.

    Raises:
        OSError: Also for a folder, a block device, and a FIFO that nobody opens for reading.
    """
    file, is_special = _resolve(target)
    if is_special:
        with tempfile.TemporaryDirectory() as folder:
            part = Path(folder) / "content"
            yield part
            _copy_into(part, file)
        return
    part = file.with_name(f".{file.name}.{os.getpid()}.part")
    try:
        yield part
        if file.exists():
            shutil.copymode(file, part)
        part.replace(file)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text file, replacing an older one whole or not at all; raises OSError."""
    path = Path(os.path.realpath(path))
    following = path.with_name(f".{path.name}.next")
    following.write_text(text, encoding="utf-8")
    fsync_path(following)
    following.replace(path)
    fsync_path(path.parent)


def _resolve(target: Path) -> tuple[Path, bool]:
    """Follow links to the file that `target` means, and return whether it must be written in place.

    /dev/stdout and the like are links to whatever file a shell has opened, which must not be replaced either.
    """
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return Path(os.path.realpath(target)), False
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(target))
    if stat.S_ISBLK(mode):
        raise OSError(errno.EINVAL, "it is a block device", str(target))
    open_file = _open_file(target)
    if open_file:
        return open_file, True
    return (target.resolve(), False) if stat.S_ISREG(mode) else (target, True)


def _open_file(target: Path) -> Path | None:
    """Return the name in a folder of open files, /proc/<pid>/fd, through which links lead, if they do."""
    while True:
        folder = os.path.realpath(target.parent)
        if folder.startswith("/proc/"):
            return Path(folder) / target.name
        if not target.is_symlink():
            return None
        target = target.parent / target.readlink()


def _copy_into(source: Path, target: Path) -> None:
    """Append the content of a file to a device, a FIFO or an open file; raises OSError."""
    with source.open("rb") as content, os.fdopen(_open_to_append(target), "wb") as file:
        shutil.copyfileobj(content, file)


def _open_to_append(target: Path) -> int:
    """Return a descriptor; of a file that is open in this process its own, whose place others share."""
    if target.parent == Path(f"/proc/{os.getpid()}/fd"):
        return os.dup(int(target.name))
    deadline = time.monotonic() + _READER_WAIT_S
    while True:
        try:
            descriptor = os.open(target, os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK)
            break
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
            if time.monotonic() > deadline:
                raise OSError(errno.ENXIO, "nobody reads from it", str(target)) from error
        time.sleep(0.05)
    os.set_blocking(descriptor, True)
    return descriptor


def move_folder_into_place(new: Path, final: Path, aside: Path) -> None:
    """Rename the folder `new` to `final` in one step, whether `final` exists or not.

    An old `final` is left at `new`, or at `aside` where the file system cannot exchange two names. In that
    case a crash between the two renames leaves `final` missing and `aside` whole: see `undo_move_aside`.
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
    """Restore a `final` that a killed `move_folder_into_place` had moved to `aside`."""
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
    """Lock the file `path`, made if missing, until the returned file is closed or its process ends.

    Raises:
        BlockingIOError: When another process holds it and `wait` is false.
    """
    while True:
        file = path.open("a+", encoding="utf-8", errors="replace")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            if _is_same_file(file, path):  # not removed by its holder while we waited
                return file
        except BaseException:
            file.close()
            raise
        file.close()


def _is_same_file(file: TextIO, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False
